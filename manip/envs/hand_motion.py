"""HandMotion: velocity and acceleration of the hand, from its positions."""

from collections.abc import Mapping

import numpy as np

Array = np.ndarray

VELOCITY, ACCELERATION = "hand_linvel", "hand_linacc"
"""Names of the motion [N, 3] among the measures."""


def motion_measures(m: Mapping[str, Array]) -> dict[str, Array]:
    """hand_speed [N] m/s and hand_acceleration [N] m/s^2, see `HandMotion`."""
    return {
        "hand_speed": np.linalg.norm(m[VELOCITY], axis=1),
        "hand_acceleration": np.linalg.norm(m[ACCELERATION], axis=1),
    }


class HandMotion:
    """Mean velocity over the last control step, and its change, of N hands.

    Differences of positions are the same in every simulation, and what a film shows.

    Args:
        num_envs: N.
        control_dt: control period [s].
    """

    def __init__(self, num_envs: int, control_dt: float) -> None:
        self._dt = control_dt
        self._rows = np.zeros((num_envs, 3, 3))
        self._rows[:, 0] = np.nan

    def begin(self, env_ids: Array, position: Array) -> None:
        """Put some environments to rest at `position` [n, 3] m."""
        self._rows[env_ids] = 0.0
        self._rows[env_ids, 0] = position

    def step(self, position: Array) -> None:
        """Continue after a control step, at `position` [N, 3] m."""
        last, velocity = self._rows[:, 0], self._rows[:, 1]
        moved = np.where(np.isnan(last), 0.0, (position - last) / self._dt)
        self._rows[:, 2] = (moved - velocity) / self._dt
        self._rows[:, 1] = moved
        self._rows[:, 0] = position

    def readings(self) -> dict[str, Array]:
        """`hand_linvel` [N, 3] m/s and `hand_linacc` [N, 3] m/s^2."""
        return {VELOCITY: self._rows[:, 1], ACCELERATION: self._rows[:, 2]}

    @property
    def rows(self) -> Array:
        """[N, 3, 3]: last position, velocity and acceleration.

        The position is NaN where it is not known; the hand is then at rest until its
        next position is.
        """
        return self._rows
