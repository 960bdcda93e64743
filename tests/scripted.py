"""Tasks as parameters of a fixture; each has a script that solves it."""

import pytest

from manip.envs.task_registry import task_names

LONG = {"ToolHang"}
"""Tasks whose scripts take hundreds of steps, for the slow tests."""

TASKS = [
    pytest.param(name, marks=pytest.mark.slow) if name in LONG else name
    for name in task_names()
]
"""Names of all tasks, as parameters of a fixture."""
