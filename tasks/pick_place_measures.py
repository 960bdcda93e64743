"""PickPlace: where an object is from the tool, its place and the bins."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.arm import both_pads_touch
from manip.tasks.pick_place_items import BIN, Item
from manip.tasks.rotations import rotation_matrix

Array = np.ndarray

QUARTER = np.array([0.0975, 0.1225])
"""Half widths [m] of a quarter of the second bin
(robosuite/environments/manipulation/pick_place.py)."""
DEPTH = 0.1
"""Height [m] above the bin's origin below which an object is in the bin (ibid.)."""
WALL = 0.03
"""y [m] of the second bin's near wall (robosuite/models/assets/arenas/)."""
OVER = 0.07
"""Offset [m] of an object from its place, in x and y, below which it is over it."""


def measure_object(read: Measures, item: Item) -> Measures:
    """Add where the object is from the tool and from its place, and the grasp.

    to_object [N, 3] m from the tool; distance [N] m, its length; to_grip [N, 3] m
    from the tool to the grip on the object; object_mat [N, 9], its rotation;
    to_place [N, 2] m from the object; height [N] m since it stood; grasped [N]
    bool, robosuite's test; firm_grasp [N] bool, with the tool inside the object's
    box; over, inside [N] bool: it is above its place, in its quarter of the bin;
    symmetry [N], of its item.
    """
    matrix, position = rotation_matrix(read["object_quat"]), read["object_pos"]
    to_object = position - read["eef_pos"]
    to_place = np.array(item.place) - position[:, :2]
    height, grasped = position[:, 2] - BIN[2], both_pads_touch(read)
    return {
        **read,
        "to_object": to_object,
        "distance": np.linalg.norm(to_object, axis=1),
        "to_grip": to_object + item.grip * matrix[:, [2, 5, 8]],
        "object_mat": matrix,
        "to_place": to_place,
        "height": height - item.stand,
        "grasped": grasped,
        "firm_grasp": grasped & _in_box(item, matrix, -to_object),
        "over": _over_place(to_place, height),
        "inside": _in_quarter(to_place, height),
        "symmetry": np.full(len(position), item.symmetry),
    }


def _in_quarter(to_place: Array, height: Array) -> Array:
    """[N] bool: the object is in its quarter of the bin (robosuite's test).

    to_place [N, 2] m from the object; height [N] m above the bin's origin.
    """
    return over_quarter(to_place) & (height > 0) & (height < DEPTH)


def over_quarter(to_place: Array) -> Array:
    """[...] bool: an object is in or above its quarter; to_place [..., 2] m from it."""
    return (np.abs(to_place) < QUARTER).all(axis=-1)


def _over_place(to_place: Array, height: Array) -> Array:
    """[N] bool: the object is above the centre of its quarter, within OVER."""
    return (np.abs(to_place) < OVER).all(axis=1) & (height > 0)


def _in_box(item: Item, matrix: Array, offset: Array) -> Array:
    """[N] bool: a point is inside the object's box.

    offset [N, 3] m from the object's origin, in world axes; matrix [N, 9]: the
    object's rotation.
    """
    # Row vector times matrix: the offset in the object's own axes.
    local = np.einsum("nij,ni->nj", matrix.reshape(-1, 3, 3), offset)
    return ((local > item.low) & (local < item.high)).all(axis=1)
