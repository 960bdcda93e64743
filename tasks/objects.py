"""What tasks with loose objects share: where they start, and how things are turned."""

from collections.abc import Mapping

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.tasks.arm import yaw_quaternion

Array = np.ndarray

PARKED = np.array([10.0, 10.0, 10.0, 1.0, 0.0, 0.0, 0.0])
"""Where robosuite drops what it does not use (environments/base.py, clear_objects)."""
TRIES = 128
"""Places drawn for each object; at most half of them are taken by other objects."""


def scatter(
    streams: EpisodeStreams, half: Mapping[str, Array], radius: Mapping[str, float]
) -> dict[str, Array]:
    """Name -> [n, 2] m: places about the origin where no two objects overlap.

    As robosuite's UniformRandomSampler draws them (utils/placement_samplers.py): one
    after the other, each uniform in a rectangle of half widths `half` [2] m, until
    its circle of `radius` [m] is clear of those before it.
    """
    placed: dict[str, Array] = {}
    for name in half:
        spots = streams.uniform(-1, 1, 2 * TRIES).reshape(-1, TRIES, 2) * half[name]
        clear = np.ones(spots.shape[:2], bool)
        for other, place in placed.items():
            gap = np.linalg.norm(spots - place[:, None], axis=2)
            clear &= gap > radius[name] + radius[other]
        placed[name] = spots[np.arange(len(spots)), clear.argmax(axis=1)]
    return placed


def poses(streams: EpisodeStreams, spots: Array, height: float) -> Array:
    """[n, 7]: qpos of free bodies at `spots` [n, 2] and `height` [m], with any yaw."""
    turn = yaw_quaternion(streams.uniform(0, 2 * np.pi, 1)[:, 0])
    return np.column_stack([spots, np.full(len(spots), height), turn])


def yaw(matrix: Array) -> Array:
    """[n] rad about the vertical, of the x axis of rotations [n, 9]."""
    return np.arctan2(matrix[:, 3], matrix[:, 0])


def turns(angle: Array) -> Array:
    """[n, 2]: cosine and sine of `angle` [n] rad."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def rotation(quat: Array) -> Array:
    """[n, 9]: the rows of the rotation matrices of unit quaternions [n, 4] wxyz."""
    w, x, y, z = quat.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([entry for row in rows for entry in row], axis=1)
