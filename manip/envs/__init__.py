"""Environments: tasks as TorchRL, on the engine and in stock robosuite."""

from manip.envs.native import NativeEnv
from manip.envs.registry import load_task, task_names
from manip.envs.stock import StockEnv
from manip.envs.task import Task

__all__ = ["NativeEnv", "StockEnv", "Task", "load_task", "task_names"]
