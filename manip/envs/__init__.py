"""Environments: tasks as TorchRL, on the engine and in stock robosuite.

The environments load TorchRL, which takes seconds, when they are first asked for:
whoever only steps the engine does not wait for it.
"""

import importlib
from typing import TYPE_CHECKING, Any

from manip.envs.make_batch import make_batch
from manip.envs.task import Task
from manip.envs.task_registry import load_task, task_names
from manip.robot_config import RobotConfig

if TYPE_CHECKING:
    from manip.envs.adapters.torchrl import TaskEnv

__all__ = ["RobotConfig", "Task", "TaskEnv", "load_task", "make_batch", "task_names"]


def __getattr__(name: str) -> Any:
    if name == "TaskEnv":
        return getattr(importlib.import_module("manip.envs.adapters.torchrl"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
