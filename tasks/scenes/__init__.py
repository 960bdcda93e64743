"""robosuite environments for the tasks that robosuite does not have."""
