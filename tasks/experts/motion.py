"""What scripts share: how a distance and a turn become an action."""

import numpy as np

Array = np.ndarray

GAIN = 20.0
"""Action for a metre of distance: full speed from 5 cm on."""
SPIN = 4.0
"""Action for a radian: full speed from 0.25 rad on."""
UP = np.array([0.0, 0.0, 1.0])


def towards(offset: Array, grip: Array) -> Array:
    """[n, 7]: along offset [n, 3] m without turning; grip [n], 1 closes, -1 opens."""
    still = np.zeros((len(offset), 3))
    return np.concatenate([np.clip(GAIN * offset, -1, 1), still, grip[:, None]], axis=1)


def upright(eef_mat: Array, turn: Array) -> Array:
    """[n, 3]: turn the tool's axis downwards, and by `turn` [n] rad about it."""
    tilt = np.cross(eef_mat[:, [2, 5, 8]], -UP)
    return np.clip(SPIN * (tilt + turn[:, None] * UP), -1, 1)
