"""Build a batch of task environments: the one function that every program uses."""

import inspect
from collections.abc import Mapping
from dataclasses import fields
from itertools import chain
from typing import Any, Literal, get_args

from manip.envs.backends.external_batch import ExternalBatch
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.backends.warp_batch import WarpBatch
from manip.envs.episode_options import EpisodeOptions
from manip.envs.external_task import ExternalTask
from manip.envs.task import Task
from manip.envs.task_batch import TaskBatch
from manip.envs.task_errors import exits_blamed
from manip.envs.task_registry import load_task
from manip.errors import UserError, check_choice, shown
from manip.robot_config import RobotConfig

Backend = Literal["native", "stock", "warp"]
"""native: the batch engine; stock: robosuite itself, one environment; warp: MuJoCo Warp
(the extra `gpu`)."""

PANDA = RobotConfig()


def make_batch(
    task: str | Task,
    num_envs: int = 1,
    *,
    backend: Backend = "native",
    robot: RobotConfig | str = PANDA,
    **options: Any,
) -> TaskBatch:
    """Build N environments of a task.

    Args:
        task: the task, or its name as in `load_task`.
        num_envs: N; 1 for the stock backend.
        backend: what steps them; tasks of another library are stepped by that library.
        robot: arm, controller and control frequency; or the arm's name alone.
        options: as in `NativeBatch`, `StockBatch`, `WarpBatch` or `ExternalBatch`.

    Raises:
        UserError: no such task, backend, robot or option value.
    """
    check_choice("backend", backend, get_args(Backend))
    robot = robot_config_of(robot)
    loaded = load_task(task) if isinstance(task, str) else task
    if not isinstance(loaded, Task):
        raise UserError(f"task must be a Task or its name, not {shown(task)}")
    with exits_blamed(loaded):
        return _build(loaded, num_envs, backend, robot, options)


def robot_config_of(robot: RobotConfig | str) -> RobotConfig:
    """The configuration; of an arm's name alone, with the default controller.

    Raises:
        UserError: it is neither.
    """
    if isinstance(robot, str):
        return RobotConfig(robot)
    if not isinstance(robot, RobotConfig):
        raise UserError(
            f"robot must be a RobotConfig or an arm's name, not {shown(robot)}"
        )
    return robot


def _build(
    task: Task,
    num_envs: int,
    backend: str,
    robot: RobotConfig,
    options: dict[str, Any],
) -> TaskBatch:
    if isinstance(task, ExternalTask):
        if backend == "warp":
            raise UserError(f"{task.name} is stepped by its own library, not by warp")
        _check_names(options, ExternalBatch)
        return ExternalBatch(task, num_envs, robot=robot, **options)
    if backend == "warp":
        _check_names(options, WarpBatch, NativeBatch)
        return WarpBatch(task, num_envs, robot=robot, **options)
    if backend == "native":
        _check_names(options, NativeBatch)
        return NativeBatch(task, num_envs, robot=robot, **options)
    if num_envs != 1:
        raise UserError(
            f"the stock backend steps one environment, not {shown(num_envs)}: start "
            "several processes, or choose the native backend"
        )
    _check_names(options, StockBatch)
    return StockBatch(task, robot=robot, **options)


def _check_names(options: Mapping[str, Any], *batches: type[TaskBatch]) -> None:
    """Raise `UserError` for an option that neither the backend nor episodes have."""
    own = [inspect.getfullargspec(each.__init__).kwonlyargs for each in batches]
    known = {*chain(*own), *(field.name for field in fields(EpisodeOptions))}
    for name in options:
        check_choice("option", name, known)
