"""Any of robosuite's own environments, two-armed ones included, as one world."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.sim.other import OtherWorld, Sight
from manip.sim.stock import Rig, check_rig, environment_names, make_stock, reseed

Array = np.ndarray

__all__ = ["check_rig", "names", "open_world"]

names = environment_names


class RobosuiteWorld(OtherWorld):
    """`robosuite.make(name, ...)`: shaped reward and success test are robosuite's.

    Observed are all its object and proprio observables but the joints' accelerations,
    which are noise to a policy. An environment that ends before its time (Wipe, when
    the arm hits something) is terminated.
    """

    def __init__(self, name: str, rig: Rig, seed: int, hard_reset: bool) -> None:
        self._stock = make_stock(name, *rig, seed, hard_reset=hard_reset)

    def action_dim(self) -> int:
        """Of all its arms and grippers."""
        return int(self._stock.action_dim)

    def start(self, seed: int) -> Sight:
        """Restart the environment's random stream and reset it."""
        reseed(self._stock, seed)
        return self._sight(self._stock.reset(), 0.0, False)

    def step(self, action: Array) -> Sight | None:
        """Take an action; broken is what is not finite afterwards."""
        found, reward, over, _ = self._stock.step(action.astype(np.float64))
        sight = self._sight(found, float(reward), over)
        finite = all(np.isfinite(part).all() for part in sight.parts.values())
        return sight if finite else None

    def _sight(self, found: Mapping[str, Any], reward: float, over: bool) -> Sight:
        sensed = self._stock._observables.items()
        parts = {
            name: np.ravel(found[name])
            for name, how in sensed
            if how.is_enabled() and how.is_active() and not name.endswith("joint_acc")
        }
        return Sight(parts, reward, bool(self._stock._check_success()), over)


open_world = RobosuiteWorld
