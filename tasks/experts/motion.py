"""How a scripted expert turns distances and angles into actions."""

import numpy as np

from manip.tasks.rotations import yaw_angle

Array = np.ndarray

GAIN = 20.0
"""Action per metre of distance: full speed from 5 cm on."""
TURN_GAIN = 4.0
"""Action per radian of rotation: full speed from 0.25 rad on."""
MIDDLE = 0.75 * np.pi
"""Yaw [rad] of a Panda's tool in the middle of the range of its wrist, +-2.9 rad, while
the arm points ahead."""
UP = np.array([0.0, 0.0, 1.0])


def move_action(offset: Array, grip: Array) -> Array:
    """[n, 7]: move along `offset` [n, 3] m without turning.

    grip [n]: 1 closes the gripper, -1 opens it.
    """
    no_turn = np.zeros((len(offset), 3))
    move = np.clip(GAIN * offset, -1, 1)
    return np.concatenate([move, no_turn, grip[:, None]], axis=1)


def upright_turn(
    eef_mat: Array, turn: Array, lean: Array | float = 0.0, tolerance: float = 0.0
) -> Array:
    """[n, 3]: the action that points the tool down and turns it by `turn` [n] rad.

    Args:
        eef_mat: [n, 9], the tool's rotation.
        turn: [n] rad.
        lean: [n, 3], added to the direction in which it points.
        tolerance: tilt [rad] that is not corrected.
    """
    tilt = np.cross(eef_mat[:, [2, 5, 8]], lean - UP)
    if tolerance:
        length = np.linalg.norm(tilt, axis=1, keepdims=True)
        tilt *= 1 - tolerance / np.maximum(length, tolerance)
    return np.clip(TURN_GAIN * (tilt + turn[:, None] * UP), -1, 1)


def wrist_turn(eef_mat: Array, goal: Array, low: float, high: float) -> Array:
    """[n] rad: nearest turn of the tool to a yaw at which its fingers lie as at `goal`.

    Args:
        eef_mat: [n, 9], the tool's rotation.
        goal: [n] rad, a yaw; half a turn from it, the fingers lie alike.
        low, high: least and greatest yaw [rad] to turn to, half a turn apart or more.
    """
    start = MIDDLE - np.pi
    yaw = np.mod(yaw_angle(eef_mat) - start, 2 * np.pi) + start
    turned = yaw + np.arctan(np.tan(goal - yaw))
    turned -= np.pi * np.maximum(np.ceil((turned - high) / np.pi), 0)
    turned += np.pi * np.maximum(np.ceil((low - turned) / np.pi), 0)
    return turned - yaw
