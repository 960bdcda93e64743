"""Batched rotations: yaw angles, quaternions wxyz, matrices as rows of nine."""

import numpy as np

from manip.arrays import namespace

Array = np.ndarray


def yaw_quaternion(yaw: Array) -> Array:
    """[n, 4] wxyz: the rotations by `yaw` [n] rad about the vertical."""
    zero = np.zeros_like(yaw)
    return np.stack([np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)], axis=1)


def tool_rotation(yaw: Array, tilt: Array) -> Array:
    """[n, 9]: rotations of a tool that points down.

    yaw [n] rad of its x axis about the vertical; tilt [n, 2] rad about the world's x
    and y axes, small.
    """
    c, s, zero = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    down = (c, s, zero, s, -c, zero, zero, zero, zero - 1)
    matrix = np.stack(down, axis=1).reshape(-1, 3, 3)
    turn = np.column_stack([tilt, zero])
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    axis = turn / np.maximum(angle, 1e-12)
    half = np.column_stack([np.cos(angle / 2), np.sin(angle / 2) * axis])
    return (rotation_matrix(half).reshape(-1, 3, 3) @ matrix).reshape(-1, 9)


def yaw_angle(matrix: Array) -> Array:
    """[n] rad: the angle about the vertical of the x axis of matrices [n, 9]."""
    return namespace(matrix).arctan2(matrix[:, 3], matrix[:, 0])


def nearest_turn(angle: Array, period: float) -> Array:
    """[n] rad: the least rotation that differs from `angle` [n] by whole periods [rad].

    With a period of a quarter turn: from a hand to the nearest pair of a cube's faces.
    """
    return angle - period * namespace(angle).round(angle / period)


def cos_sin(angle: Array) -> Array:
    """[n, 2]: cosine and sine of `angle` [n] rad, continuous where angles jump."""
    xp = namespace(angle)
    return xp.stack([xp.cos(angle), xp.sin(angle)], axis=1)


def rotation_matrix(quat: Array) -> Array:
    """[n, 9]: the rotation matrices, row by row, of unit quaternions [n, 4] wxyz."""
    w, x, y, z = quat.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return namespace(quat).stack([entry for row in rows for entry in row], axis=1)
