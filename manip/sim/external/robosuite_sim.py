"""Any environment of robosuite, two-armed ones included."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.cameras import CameraConfig
from manip.robot_config import RobotConfig, check_robot_config
from manip.sim.external.external_sim import ExternalSim, ExternalStep
from manip.sim.robosuite_factory import environment_names, reseed
from manip.sim.robosuite_log import quiet
from manip.sim.stock_driver import open_stock

Array = np.ndarray

__all__ = ["check_robot_config", "names", "open_sim"]

names = environment_names


class RobosuiteSim(ExternalSim):
    """`robosuite.make(name, ...)` with robosuite's shaped reward and success test.

    The observation is all its object and proprio observables except the joints'
    accelerations, which are noise to a policy. An environment that ends before its
    time limit (Wipe, when the arm collides) is terminated.
    """

    def __init__(
        self,
        name: str,
        robot: RobotConfig,
        seed: int,
        hard_reset: bool,
        cameras: CameraConfig,
    ) -> None:
        self._driver = open_stock(name, robot, seed, cameras, hard_reset=hard_reset)
        self._stock = self._driver.stock
        self._image_names = [part.name for part in cameras.parts]

    def action_dim(self) -> int:
        """Length of an action of all its arms and grippers."""
        return int(self._stock.action_dim)

    def start(self, seed: int) -> ExternalStep:
        """Restart the environment's random stream and reset it."""
        reseed(self._stock, seed)
        with quiet():  # a hard reset builds the robot again
            observation = self._driver.run(self._stock.reset)
        return self._external_step(observation, 0.0, False)

    def step(self, action: Array) -> ExternalStep | None:
        """Take an action; None if an observation is not finite afterwards."""
        taken = action.astype(np.float64)
        observation, reward, over, _ = self._driver.run(lambda: self._stock.step(taken))
        step = self._external_step(observation, float(reward), over)
        finite = all(np.isfinite(part).all() for part in step.parts.values())
        return step if finite else None

    def _external_step(
        self, observation: Mapping[str, Any], reward: float, over: bool
    ) -> ExternalStep:
        parts = {
            name: np.ravel(observation[name])
            for name, observable in self._stock._observables.items()
            if observable.is_enabled()
            and observable.is_active()
            and observable.modality != "image"
            and not name.endswith("joint_acc")
        }
        images = {name: observation[name] for name in self._image_names}
        success = bool(self._stock._check_success())
        return ExternalStep(parts, reward, success, over, images)


open_sim = RobosuiteSim
