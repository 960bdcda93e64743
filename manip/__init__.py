"""manip: train a 7-DoF arm on robosuite's own tasks, at native speed."""
