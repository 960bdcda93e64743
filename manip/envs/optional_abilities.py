"""What only some backends can do."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.errors import UserError

Array = np.ndarray


class OptionalAbilities:
    """Methods of a batch that raise `UserError` unless its backend defines them."""

    def _draw(self, env_ids: Array) -> Mapping[str, Array]:
        """Part name -> uint8 [n, H, W, 3], the cameras of the given environments."""
        raise UserError(f"{type(self).__name__} has no cameras")

    def save_state(self) -> dict[str, Any]:
        """Complete state, as plain values and arrays."""
        raise UserError(f"{type(self).__name__} cannot save its state")

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned; `observe` then shows it."""
        raise UserError(f"{type(self).__name__} cannot restore a state")

    def record(self) -> dict[str, Array]:
        """Rows [N, ...] from which each environment's present state can be restored.

        They are part of what `save_state` returns, under the same names.
        """
        raise UserError(f"{type(self).__name__} cannot record its states")

    def motion(self) -> dict[str, Array]:
        """How the robots moved in the last control step, see `RobotMotion.read`."""
        raise UserError(
            f"{type(self).__name__} does not read how the robot moves: choose the "
            "native backend with motion=True"
        )
