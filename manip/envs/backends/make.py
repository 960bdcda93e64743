"""One world of a task: what the interfaces of single environments adapt."""

from typing import Any, Literal

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.task_batch import TaskBatch
from manip.envs.task_registry import load_task
from manip.errors import check_choice

Where = Literal["native", "stock"]
"""On the batch engine, or in stock robosuite."""


def one_world(task: str, env: Where, **options: Any) -> TaskBatch:
    """One world of the task called `task`.

    Args:
        task: name, or package.module:Task.
        env: "native" or "stock".
        options: as in `NativeBatch` or `StockBatch`.

    Raises:
        UserError: no such task.
    """
    check_choice("env", env, ("native", "stock"))
    if env == "native":
        return NativeBatch(load_task(task), 1, **options)
    return StockBatch(load_task(task), **options)
