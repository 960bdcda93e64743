"""StockBatch: one environment of a task, stepped by robosuite itself."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.cameras import check_cameras
from manip.envs.episode_options import EpisodeOptions
from manip.envs.episode_streams import episode_seed
from manip.envs.option_checks import check_flag
from manip.envs.task import Measures, Task
from manip.envs.task_batch import TaskBatch
from manip.robot_config import RobotConfig
from manip.sim.exclusive_use import ExclusiveUse
from manip.sim.not_copied import NotCopied
from manip.sim.robosuite_factory import PANDA, reseed
from manip.sim.stock_check import check_stock
from manip.sim.stock_driver import StockDriver, check_stock_cameras, open_stock
from manip.sim.stock_reader import stock_reader
from manip.sim.stock_variation import StockVariation

Array = np.ndarray


class StockBatch(NotCopied, TaskBatch):
    """One environment of a task, stepped by `robosuite.make(...)` itself.

    Unlike robosuite's GymWrapper it reports the time limit as `truncated`, reports
    success, and a seed fixes the episodes (see `episode_seed`).

    Args:
        task: the task.
        robot: arm, controller and control frequency.
        hard_reset: rebuild the model at every reset, as robosuite does by default;
            what it samples when it builds (Lift's cube size) then varies.
        stock: a robosuite environment to step, instead of building one. It must be
            what `make_stock(task.robosuite_name, robot)` builds (see `check_stock`),
            and observe the cameras of the options.
        options: as in `EpisodeOptions`.
    """

    def __init__(
        self,
        task: Task,
        *,
        robot: RobotConfig = PANDA,
        hard_reset: bool = False,
        stock: Any = None,
        **options: Any,
    ) -> None:
        check_flag("hard_reset", hard_reset)
        episodes = EpisodeOptions(**options)
        episodes.refuse_looks("robosuite")
        cameras = check_cameras(episodes.cameras)
        if stock is None:
            self._driver = open_stock(
                task.robosuite_name,
                robot,
                episodes.seed,
                cameras,
                hard_reset=hard_reset,
            )
        else:
            horizon = episodes.horizon or task.horizon
            check_stock(stock, task.robosuite_name, robot, horizon)
            check_stock_cameras(stock, cameras)
            self._driver = StockDriver(stock)
        self.stock = self._driver.stock
        self._observation: Mapping[str, Array] = {}
        self._reader = stock_reader(self.stock, task.sensors)
        self._memory = _blank(task)
        self._exclusive = ExclusiveUse("the robosuite environment")
        self._variation = StockVariation(self.stock, task.sensors)
        action_dim = self.stock.action_dim
        super().__init__(task, 1, action_dim, episodes, robot.control_freq)

    def read(self) -> Measures:
        """As `manip.sim.stock_reader.stock_reader`."""
        with self._exclusive:
            return {**self._reader(), **self._memory}

    def visual_model(self, env_id: int) -> Any:
        """The stock environment's own model."""
        return self.stock.sim.model._model

    def _draw(self, env_ids: Array) -> Mapping[str, Array]:
        """The images that robosuite observed last."""
        names = [part.name for part in self.cameras.parts]
        return {name: self._observation[name][None] for name in names}

    def _start_episodes(self, env_ids: Array) -> None:
        key = episode_seed(
            self.seed, self.purpose, self.first_env, int(self.episode[0])
        )
        reseed(self.stock, key)
        values = self._perturber.model_values(env_ids) if self._perturber else {}
        drawn = {name: float(value[0]) for name, value in values.items()}
        with self._exclusive:
            self._variation.before_reset(drawn)
            self._observation = self._driver.run(self.stock.reset)
            self._variation.after_reset(drawn)
        self._memory = _blank(self.task)
        if self.stock.hard_reset:
            self._reader = stock_reader(self.stock, self.task.sensors)

    def _keep(self, env_ids: Array, memory: Mapping[str, Array]) -> None:
        if len(env_ids):
            self._memory = {**self._memory, **memory}

    def _move(self, action: Array) -> Array:
        broken = np.isnan(action).any(axis=1)
        if not broken[0]:
            taken = action[0].astype(np.float64)
            with self._exclusive:
                step = self._driver.run(lambda: self.stock.step(taken))
            self._observation = step[0]
        return broken


def _blank(task: Task) -> dict[str, Array]:
    """The memory of an episode that begins."""
    return {name: np.zeros((1, size)) for name, size in task.sensors.memory.items()}
