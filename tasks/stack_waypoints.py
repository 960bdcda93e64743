"""Stack: its waypoints, A in the closed hand on its way onto B.

grasp: A lies where it starts. lift: 3.5 to 15 cm above the table, up to two thirds of
the way to B. aligned: 0.5 to 6 cm above B, within 2 cm of its axis. on: A rests on B,
within 1.5 cm of its axis.
"""

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Start, Waypoint
from manip.tasks.held_objects import GraspSpread, grasp, nearest_yaw
from manip.tasks.stack_rewards import STACKED

Array = np.ndarray

NAMES = ("grasp", "lift", "aligned", "on")
LIFTED = (0.035, 0.15)
"""Least and greatest height [m] of a lifted A above where it lay."""
WAY = 2 / 3
"""Greatest part of the way from A's start to B of a lifted A."""
ABOVE_B = {"aligned": (0.005, 0.06), "on": (0.0, 0.001)}
"""Least and greatest height [m] of A above where it rests on B."""
ASIDE = {"aligned": 0.02, "on": 0.015}
"""Greatest distance [m] of A from B's axis."""
GRASP = GraspSpread((0.005, 0.005, 0.008))


def place_cubes(
    milestone: str, streams: EpisodeStreams, start: Start, a: slice, b: slice
) -> Waypoint:
    """Put A, which lies on the table beside B, into the hand at a milestone.

    a, b: entries of their free bodies in qpos.
    """
    cube, spot_b = start.qpos[:, a], start.qpos[:, b][:, :3]
    if milestone == "lift":
        cube[:, :3] += _lift(streams, spot_b - cube[:, :3])
    if milestone in ABOVE_B:
        cube[:, :3] = spot_b + _above_b(milestone, streams)
    yaw = nearest_yaw(2 * np.arctan2(cube[:, 6], cube[:, 3]), 4)
    return grasp(streams, start, cube[:, :3], yaw, GRASP)


def _lift(streams: EpisodeStreams, to_b: Array) -> Array:
    """[n, 3] m: from where A lies to where it is lifted; `to_b` [n, 3] m to B."""
    way, height = streams.uniform(0, WAY, 1), streams.uniform(*LIFTED, 1)
    return np.hstack([way * to_b[:, :2], height])


def _above_b(milestone: str, streams: EpisodeStreams) -> Array:
    """[n, 3] m: from B's centre to A's."""
    aside = ASIDE[milestone] * np.sqrt(streams.uniform(0, 1, 1))
    angle = streams.uniform(0, 2 * np.pi, 1)
    height = STACKED + streams.uniform(*ABOVE_B[milestone], 1)
    return np.hstack([aside * np.cos(angle), aside * np.sin(angle), height])
