"""Names of all tasks, as parameters of a fixture; each has an expert that solves it."""

import pytest

from manip.envs.task_registry import task_names

LONG = {"NutAssembly", "PickPlace", "ToolHang"}
"""Tasks whose experts take hundreds of steps."""
ALIKE = {"NutAssemblyRound", "PickPlaceBread", "PickPlaceMilk"}
"""Tasks that differ from another one in a few numbers."""


def _parameters(slow: set[str]) -> list:
    return [
        pytest.param(name, marks=pytest.mark.slow) if name in slow else name
        for name in task_names()
    ]


ALL_TASKS = _parameters(slow=LONG)
"""For tests of the tasks."""
TASKS = _parameters(slow=LONG | ALIKE)
"""For tests of what steps them."""
