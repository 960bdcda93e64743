"""robosuite environments of our own, for tasks that robosuite lacks."""
