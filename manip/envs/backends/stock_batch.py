"""StockBatch: one environment of a task, stepped by robosuite itself."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.envs.task import Measures, Task
from manip.envs.task_batch import TaskBatch
from manip.robot_config import RobotConfig
from manip.sim.exclusive_use import ExclusiveUse
from manip.sim.not_copied import NotCopied
from manip.sim.robosuite_factory import PANDA, make_stock, reseed
from manip.sim.stock_check import check_stock
from manip.sim.stock_reader import stock_reader

Array = np.ndarray


class StockBatch(NotCopied, TaskBatch):
    """One environment of a task, stepped by `robosuite.make(...)` itself.

    Unlike robosuite's GymWrapper it reports the time limit as `truncated`, reports
    success, and a seed fixes the episodes (episode e starts from `seed + e`).

    Args:
        task: the task.
        robot, horizon, reward, seed: as in `NativeBatch`.
        hard_reset: rebuild the model at every reset, as robosuite does by default;
            what it samples when it builds (Lift's cube size) then varies.
        stock: a robosuite environment to step, instead of building one. It must be
            what `make_stock(task.robosuite_name, robot)` builds (see `check_stock`).
    """

    def __init__(
        self,
        task: Task,
        *,
        robot: RobotConfig = PANDA,
        horizon: int | None = None,
        reward: str = "shaped",
        seed: int = 0,
        hard_reset: bool = False,
        stock: Any = None,
    ) -> None:
        self.stock = stock or make_stock(
            task.robosuite_name,
            robot,
            seed,
            hard_reset=hard_reset,
        )
        if stock is not None:
            check_stock(stock, task.robosuite_name, robot, horizon or task.horizon)
        self._reader = stock_reader(self.stock, task.sensors)
        self._memory = _blank(task)
        self._exclusive = ExclusiveUse("the robosuite environment")
        action_dim = self.stock.action_dim
        super().__init__(task, 1, action_dim, horizon, reward, seed)

    def read(self) -> Measures:
        """As `manip.sim.stock_reader.stock_reader`."""
        with self._exclusive:
            return {**self._reader(), **self._memory}

    def visual_model(self, world: int) -> Any:
        """The stock environment's own model."""
        return self.stock.sim.model._model

    def _start_episodes(self, worlds: Array) -> None:
        reseed(self.stock, self.seed + int(self.episode[0]))
        with self._exclusive:
            self.stock.reset()
        self._memory = _blank(self.task)
        if self.stock.hard_reset:
            self._reader = stock_reader(self.stock, self.task.sensors)

    def _keep(self, worlds: Array, memory: Mapping[str, Array]) -> None:
        if len(worlds):
            self._memory = {**self._memory, **memory}

    def _move(self, action: Array) -> Array:
        broken = np.isnan(action).any(axis=1)
        if not broken[0]:
            with self._exclusive:
                self.stock.step(action[0].astype(np.float64))
        return broken


def _blank(task: Task) -> dict[str, Array]:
    """The memory of an episode that begins."""
    return {name: np.zeros((1, size)) for name, size in task.sensors.memory.items()}
