"""PickPlace: its waypoints, the object in the closed hand on its way to its place.

grasp: the object stands where it starts. lift: 11 to 25 cm above it, over the first
bin. across: as high, past the wall, between the bins' centres. over: above its place,
up to 6.5 cm nearer to the robot, 0 to 15 cm above where it would stand.
"""

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Start, Waypoint
from manip.tasks.held_objects import grasp, nearest_yaw
from manip.tasks.pick_place_items import BIN, ITEMS, SPREAD, standing
from manip.tasks.pick_place_measures import WALL

Array = np.ndarray

NAMES = ("grasp", "lift", "across", "over")
LIFTED = (0.11, 0.25)
"""Least and greatest height [m] of a lifted object above where it stood."""
LOWERED = 0.15
"""Greatest height [m] of an object above its place."""
MARGIN = 0.02
"""Distance [m] past the wall from which an object counts as across."""
PALM = 0.028
"""Distance [m] of the tool from an object's top at which the palm is just above it."""
ASIDE = 0.065
"""Greatest distance [m], in x and y, of an object from its place. The arm does not
reach the farthest place, the can's, in full."""
REST_ASIDE = 0.045
"""Greatest distance [m], in x and y, of an object that is done from its place: clear of
the bin's walls."""


def place_object(
    name: str, milestone: str, streams: EpisodeStreams, start: Start, body: slice
) -> Waypoint:
    """Put an object, which stands at its start, into the hand at a milestone.

    body: entries of its free body in qpos.
    """
    item, qpos = ITEMS[name], start.qpos
    pose = qpos[:, body]
    if milestone != "grasp":
        pose[:, :3] = _position(name, milestone, streams)
    qpos[:, body] = pose
    depth = max(item.grip, item.high[2] - PALM)
    grip = pose[:, :3] + [0.0, 0.0, depth]
    across = 2 * np.arctan2(pose[:, 6], pose[:, 3]) + np.pi / 2
    yaw = nearest_yaw(across, item.symmetry or 8)
    return grasp(streams, start, grip, yaw)


def stand_in_place(name: str, streams: EpisodeStreams) -> Array:
    """[n, 7]: qpos of an object that stands in its quarter of the bin, any yaw."""
    offset = streams.uniform(-REST_ASIDE, REST_ASIDE, 2)
    return standing(streams, name, np.array(ITEMS[name].place) + offset)


def _position(name: str, milestone: str, streams: EpisodeStreams) -> Array:
    """[n, 3] m: where the object's origin is."""
    unit, item = streams.uniform(0, 1, 3), ITEMS[name]
    place, half = np.array(item.place), SPREAD - item.radius
    low, high = {
        "lift": ((*(BIN[:2] - half), LIFTED[0]), (*(BIN[:2] + half), LIFTED[1])),
        "across": (
            (min(BIN[0], place[0]) - ASIDE, WALL + MARGIN, LIFTED[0]),
            (max(BIN[0], place[0]) + ASIDE, place[1], LIFTED[1]),
        ),
        "over": ((*(place - ASIDE), 0.0), (*place, LOWERED)),
    }[milestone]
    spot: Array = low + (np.array(high) - low) * unit
    spot[:, 2] += BIN[2] + item.stand
    return spot
