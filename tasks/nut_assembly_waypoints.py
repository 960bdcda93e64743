"""NutAssembly: its waypoints, the nut in the closed hand on its way down its peg.

grasp: the nut lies on the table where it starts. lift: 3.5 to 10 cm above it. over:
1.5 to 6 cm above the peg's top, within 2.5 cm of its axis. on_peg: the peg is in the
nut, above the height of success. The yaw is any, but on the peg one in which the nut
fits over it.
"""

from typing import NamedTuple

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Start, Waypoint
from manip.tasks.held_objects import GraspSpread, grasp, nearest_yaw
from manip.tasks.nut_assembly_measures import REST, SUCCESS_HEIGHT, TOP
from manip.tasks.rotations import yaw_quaternion

Array = np.ndarray

NAMES = ("grasp", "lift", "over", "on_peg")
PEG = np.array([0.23, 0.1])
"""Position [m] of the square nut's peg; the round one's is mirrored in y
(robosuite/models/assets/arenas/pegs_arena.xml)."""
OUTWARDS = 0.008
"""Distance [m] of the best grasp from the handle's centre, away from the nut."""
GRASP = GraspSpread((0.004, 0.004, 0.006), yaw=0.1, tilt=0.05)
LYING = (REST + 0.0005, REST + 0.001)
HEIGHTS = {
    "grasp": LYING,
    "lift": (REST + 0.035, REST + 0.1),
    "over": (TOP + 0.015, TOP + 0.06),
    "on_peg": (SUCCESS_HEIGHT + 0.005, TOP - 0.005),
    "rest": LYING,
}
"""Least and greatest height [m] of the nut's centre."""
ON_PEG = ("on_peg", "rest")
"""Heights at which the peg is in the nut."""
MISALIGNED = 0.03
"""Greatest yaw [rad] of a nut on its peg, from one in which it fits."""


class Nut(NamedTuple):
    """A nut: its peg, and how it fits over it.

    Attributes:
        side: 1 if its peg is at positive y, else -1.
        play: as in `OneNut`.
        handle: distance [m] of the handle's centre from the nut's.
        fits: number of yaws in which it fits over its peg; 0 for any.
    """

    side: int
    play: float
    handle: float
    fits: int


def place_nut(
    nut: Nut, milestone: str, streams: EpisodeStreams, start: Start, body: slice
) -> Waypoint:
    """Put a nut, which is at its start, into the hand at a milestone.

    body: entries of its free body in qpos.
    """
    qpos = start.qpos
    position, yaw = _pose(nut, milestone, streams, qpos[:, body][:, :2])
    qpos[:, body] = np.hstack([position, yaw_quaternion(yaw)])
    towards = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)])
    grip = position + (nut.handle + OUTWARDS) * towards
    return grasp(streams, start, grip, nearest_yaw(yaw + np.pi / 2, 2), GRASP)


def rest_on_peg(nut: Nut, streams: EpisodeStreams) -> Array:
    """[n, 7]: qpos of a nut that lies around its peg."""
    position, yaw = _pose(nut, "rest", streams, PEG)
    return np.hstack([position, yaw_quaternion(yaw)])


def _pose(
    nut: Nut, milestone: str, streams: EpisodeStreams, first: Array
) -> tuple[Array, Array]:
    """[n, 3] m and [n] rad: the nut's centre and yaw; first: as in `_spot`."""
    spot = _spot(nut, milestone, streams, first)
    yaw = _yaw(nut, milestone, streams)
    return np.column_stack([spot, streams.uniform(*HEIGHTS[milestone], 1)]), yaw


def _spot(nut: Nut, milestone: str, streams: EpisodeStreams, first: Array) -> Array:
    """[n, 2] m: x and y of the nut's centre; `first` [n, 2] m is where it starts."""
    peg, unit = PEG * [1, nut.side], streams.uniform(0, 1, 2)
    if milestone == "grasp":
        return first
    if milestone == "lift":
        return first + (peg - first) * unit
    aside = 0.025 if milestone == "over" else nut.play / 2
    return peg + aside * (unit - 0.5) * np.sqrt(2)


def _yaw(nut: Nut, milestone: str, streams: EpisodeStreams) -> Array:
    """[n] rad: the nut's yaw."""
    unit = streams.uniform(0, 1, 2)
    if milestone not in ON_PEG or not nut.fits:
        return 2 * np.pi * unit[:, 0]
    fitting = np.floor(nut.fits * unit[:, 0]) * 2 * np.pi / nut.fits
    return fitting + MISALIGNED * (2 * unit[:, 1] - 1)
