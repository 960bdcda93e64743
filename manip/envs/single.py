"""One world of a task: what the interfaces of single environments adapt."""

from typing import Any, Literal

from manip.envs.native import NativeWorlds
from manip.envs.registry import load_task
from manip.envs.stock import StockWorlds
from manip.envs.worlds import Worlds
from manip.sim.stock import check_choice

Where = Literal["native", "stock"]
"""On the batch engine, or in stock robosuite."""


def one_world(task: str, env: Where, **options: Any) -> Worlds:
    """One world of the task called `task`.

    Args:
        task: name, or package.module:Task.
        env: "native" or "stock".
        options: as in `NativeWorlds` or `StockWorlds`.

    Raises:
        UserError: no such task.
    """
    check_choice("env", env, ("native", "stock"))
    if env == "native":
        return NativeWorlds(load_task(task), 1, **options)
    return StockWorlds(load_task(task), **options)
