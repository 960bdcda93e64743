"""Environments: tasks on the batch engine, in stock robosuite, and in TorchRL.

`TaskEnv` loads TorchRL, which takes seconds, when it is first used.
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
