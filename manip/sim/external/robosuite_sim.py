"""Any of robosuite's own environments, two-armed ones included, as one world."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.robot_config import RobotConfig, check_robot_config
from manip.sim.external.external_sim import ExternalSim, ExternalStep
from manip.sim.robosuite_factory import environment_names, make_stock, reseed

Array = np.ndarray

__all__ = ["check_robot_config", "names", "open_world"]

names = environment_names


class RobosuiteSim(ExternalSim):
    """`robosuite.make(name, ...)`: shaped reward and success test are robosuite's.

    Observed are all its object and proprio observables but the joints' accelerations,
    which are noise to a policy. An environment that ends before its time (Wipe, when
    the arm hits something) is terminated.
    """

    def __init__(
        self, name: str, robot: RobotConfig, seed: int, hard_reset: bool
    ) -> None:
        self._stock = make_stock(name, robot, seed, hard_reset=hard_reset)

    def action_dim(self) -> int:
        """Of all its arms and grippers."""
        return int(self._stock.action_dim)

    def start(self, seed: int) -> ExternalStep:
        """Restart the environment's random stream and reset it."""
        reseed(self._stock, seed)
        return self._sight(self._stock.reset(), 0.0, False)

    def step(self, action: Array) -> ExternalStep | None:
        """Take an action; broken is what is not finite afterwards."""
        found, reward, over, _ = self._stock.step(action.astype(np.float64))
        sight = self._sight(found, float(reward), over)
        finite = all(np.isfinite(part).all() for part in sight.parts.values())
        return sight if finite else None

    def _sight(
        self, found: Mapping[str, Any], reward: float, over: bool
    ) -> ExternalStep:
        sensed = self._stock._observables.items()
        parts = {
            name: np.ravel(found[name])
            for name, how in sensed
            if how.is_enabled() and how.is_active() and not name.endswith("joint_acc")
        }
        return ExternalStep(parts, reward, bool(self._stock._check_success()), over)


open_world = RobosuiteSim
