"""Start poses of loose objects, drawn as robosuite draws them."""

from collections.abc import Mapping

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.tasks.rotations import yaw_quaternion

Array = np.ndarray

PARKED = np.array([10.0, 10.0, 10.0, 1.0, 0.0, 0.0, 0.0])
"""Pose of objects that an episode does not use (robosuite/environments/base.py,
clear_objects)."""
CANDIDATES = 128
"""Positions drawn per object. Other objects cover at most half of them."""


def scatter(
    streams: EpisodeStreams, half: Mapping[str, Array], radius: Mapping[str, float]
) -> dict[str, Array]:
    """Draw positions around the origin at which no two objects overlap.

    The method of robosuite's UniformRandomSampler (utils/placement_samplers.py): one
    object after the other is drawn uniformly in a rectangle, until its circle is clear
    of the circles of all objects before it.

    Args:
        streams: random streams of n episodes.
        half: name -> half widths [2] m of the object's rectangle.
        radius: name -> radius [m] of the object's circle.

    Returns:
        Name -> [n, 2] m.
    """
    placed: dict[str, Array] = {}
    for name in half:
        drawn = streams.uniform(-1, 1, 2 * CANDIDATES)
        spots = drawn.reshape(-1, CANDIDATES, 2) * half[name]
        clear = np.ones(spots.shape[:2], bool)
        for other, spot in placed.items():
            gap = np.linalg.norm(spots - spot[:, None], axis=2)
            clear &= gap > radius[name] + radius[other]
        placed[name] = spots[np.arange(len(spots)), clear.argmax(axis=1)]
    return placed


def poses_with_any_yaw(streams: EpisodeStreams, spots: Array, height: float) -> Array:
    """[n, 7]: qpos of free bodies at `spots` [n, 2] m and `height` m, yaw uniform."""
    turn = yaw_quaternion(streams.uniform(0, 2 * np.pi, 1)[:, 0])
    return np.column_stack([spots, np.full(len(spots), height), turn])
