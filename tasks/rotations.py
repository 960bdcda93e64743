"""Batched rotations: yaw angles, quaternions wxyz, matrices as rows of nine."""

import numpy as np

Array = np.ndarray


def yaw_quaternion(yaw: Array) -> Array:
    """[n, 4] wxyz: the rotations by `yaw` [n] rad about the vertical."""
    zero = np.zeros_like(yaw)
    return np.stack([np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)], axis=1)


def yaw_angle(matrix: Array) -> Array:
    """[n] rad: the angle about the vertical of the x axis of matrices [n, 9]."""
    return np.arctan2(matrix[:, 3], matrix[:, 0])


def cos_sin(angle: Array) -> Array:
    """[n, 2]: cosine and sine of `angle` [n] rad, continuous where angles jump."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def rotation_matrix(quat: Array) -> Array:
    """[n, 9]: the rotation matrices, row by row, of unit quaternions [n, 4] wxyz."""
    w, x, y, z = quat.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([entry for row in rows for entry in row], axis=1)
