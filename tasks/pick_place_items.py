"""PickPlace: the four objects, and where they start."""

from typing import NamedTuple

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.tasks.placement import poses_with_any_yaw, scatter

Array = np.ndarray


class Item(NamedTuple):
    """An object: its dimensions [m], its grip, and its target.

    Attributes:
        radius: of the circle that no other object may overlap
            (robosuite/models/assets/objects/*.xml).
        stand: height of its origin above the bin's when it stands in it (ibid.).
        low, high: corners of its box, in its own frame.
        grip: height of the grasping tool above its origin.
        symmetry: number of evenly spaced yaws at which it can be grasped alike; 0 if it
            can be grasped at any yaw.
        place: [2], centre of its quarter of the second bin, in the world frame.
    """

    radius: float
    stand: float
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    grip: float
    symmetry: int
    place: tuple[float, float]


ITEMS = {
    "Milk": Item(
        radius=0.025,
        stand=0.085,
        low=(-0.020, -0.020, -0.061),
        high=(0.020, 0.020, 0.083),
        grip=0.045,
        symmetry=4,
        place=(0.0025, 0.1575),
    ),
    "Bread": Item(
        radius=0.03,
        stand=0.045,
        low=(-0.024, -0.020, -0.023),
        high=(0.024, 0.020, 0.025),
        grip=0.0,
        symmetry=4,
        place=(0.1975, 0.1575),
    ),
    "Cereal": Item(
        radius=0.04,
        stand=0.1,
        low=(-0.050, -0.015, -0.075),
        high=(0.050, 0.015, 0.075),
        grip=0.04,
        symmetry=2,
        place=(0.0025, 0.4025),
    ),
    "Can": Item(
        radius=0.025,
        stand=0.06,
        low=(-0.025, -0.025, -0.040),
        high=(0.025, 0.025, 0.040),
        grip=0.0,
        symmetry=0,
        place=(0.1975, 0.4025),
    ),
}
"""The objects, in the order in which robosuite places them."""

BIN = np.array([0.1, -0.25, 0.8])
"""Origin [m] of the first bin (robosuite/environments/manipulation/pick_place.py)."""
SPREAD = np.array([0.145, 0.195])
"""Half widths [m] of the rectangle in which an object's circle starts (ibid.)."""


def start_spots(streams: EpisodeStreams) -> dict[str, Array]:
    """Name -> [n, 2] m: where the objects start, clear of one another."""
    spread = {name: SPREAD - item.radius for name, item in ITEMS.items()}
    radius = {name: item.radius for name, item in ITEMS.items()}
    spots = scatter(streams, spread, radius)
    return {name: BIN[:2] + spot for name, spot in spots.items()}


def standing(streams: EpisodeStreams, name: str, spots: Array) -> Array:
    """[n, 7]: qpos of an object that stands at `spots` [n, 2] m in a bin, any yaw."""
    return poses_with_any_yaw(streams, spots, BIN[2] + ITEMS[name].stand)
