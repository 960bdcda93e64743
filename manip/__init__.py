"""manip: train a 7-DoF arm on robosuite's own tasks, at native speed."""

import os

# TorchRL reports every buffer it allocates; warnings still come through.
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")
