"""How a scripted expert turns distances and angles into actions."""

import numpy as np

Array = np.ndarray

GAIN = 20.0
"""Action per metre of distance: full speed from 5 cm on."""
TURN_GAIN = 4.0
"""Action per radian of rotation: full speed from 0.25 rad on."""
UP = np.array([0.0, 0.0, 1.0])


def move_action(offset: Array, grip: Array) -> Array:
    """[n, 7]: move along `offset` [n, 3] m without turning.

    grip [n]: 1 closes the gripper, -1 opens it.
    """
    no_turn = np.zeros((len(offset), 3))
    move = np.clip(GAIN * offset, -1, 1)
    return np.concatenate([move, no_turn, grip[:, None]], axis=1)


def upright_turn(eef_mat: Array, turn: Array) -> Array:
    """[n, 3]: the action that points the tool down and turns it by `turn` [n] rad."""
    tilt = np.cross(eef_mat[:, [2, 5, 8]], -UP)
    return np.clip(TURN_GAIN * (tilt + turn[:, None] * UP), -1, 1)
