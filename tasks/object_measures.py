"""Visible measures of tasks in which a gripper moves an object."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.rotations import rotation_matrix

Array = np.ndarray


def object_measures(m: Measures, body: str) -> dict[str, Array]:
    """Visible measures [N] of a free body, a name of `Sensors.bodies`.

    object_distance [m] from the tool; object_height [m], the task's `height`;
    object_speed [m/s]; object_tilt [rad], see `tilt`; grip: 0, 0.5 or 1 while none, one
    or both of the finger pads touch it.
    """
    touched = (m["left_touch"] > 0) + 1.0 * (m["right_touch"] > 0)
    return {
        "object_distance": m["distance"],
        "object_height": m["height"],
        "object_speed": np.linalg.norm(m[f"{body}_linvel"], axis=1),
        "object_tilt": tilt(rotation_matrix(m[f"{body}_quat"])),
        "grip": touched / 2,
    }


def tilt(matrix: Array) -> Array:
    """[n] rad: angle between the z axis of matrices [n, 9] and straight up."""
    axis = matrix[:, [2, 5, 8]]
    return np.arctan2(np.linalg.norm(axis[:, :2], axis=1), axis[:, 2])


def diagonal_speed(velocity: Array) -> Array:
    """[n] m/s: the smaller of |x| and |y| of velocities [n, 3].

    It is 0 in motion parallel to an edge of the table, and greatest along a diagonal.
    """
    return np.abs(velocity[:, :2]).min(axis=1)
