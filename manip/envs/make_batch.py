"""Build a batch of task environments: the one place where every program gets them."""

from typing import Any, Literal

from manip.envs.backends.external_batch import ExternalBatch, ExternalTask
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.task import Task
from manip.envs.task_batch import TaskBatch
from manip.envs.task_registry import load_task
from manip.errors import UserError, check_choice
from manip.robot_config import RobotConfig

Backend = Literal["native", "stock"]
"""native: the batch engine; stock: robosuite itself, one environment."""

PANDA = RobotConfig()


def make_batch(
    task: str | Task,
    num_envs: int = 1,
    *,
    backend: Backend = "native",
    robot: RobotConfig = PANDA,
    **options: Any,
) -> TaskBatch:
    """Build N environments of a task.

    Args:
        task: the task, its name, or package.module:Task.
        num_envs: N; 1 for the stock backend.
        backend: what steps them; tasks of another library are stepped by that library.
        robot: arm, controller and control frequency.
        options: as in `NativeBatch`, `StockBatch` or `ExternalBatch`.

    Raises:
        UserError: no such task, backend, robot or option value.
    """
    check_choice("backend", backend, ("native", "stock"))
    found = load_task(task) if isinstance(task, str) else task
    if isinstance(found, ExternalTask):
        return ExternalBatch(found, num_envs, robot=robot, **options)
    if backend == "native":
        return NativeBatch(found, num_envs, robot=robot, **options)
    if num_envs != 1:
        raise UserError(
            f"the stock backend steps one environment, not {num_envs}: start several "
            "processes, or choose the native backend"
        )
    return StockBatch(found, robot=robot, **options)
