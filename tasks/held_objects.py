"""Waypoints of tasks in which a gripper holds an object: where the tool is then."""

from typing import NamedTuple

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Start, Waypoint
from manip.tasks.rotations import tool_rotation

Array = np.ndarray


REST_YAW = np.pi / 2
"""Yaw [rad] of the tool in the default poses of robosuite's arms."""


class GraspSpread(NamedTuple):
    """Differences of generated grasps from the best one.

    Attributes:
        offset: [3] m, largest differences of the tool's position, uniform: to both
            sides along x and y, upwards along z.
        yaw: half width [rad] of the tool's yaw, uniform.
        tilt: standard deviation [rad] of the tool's tilt about x and y.
    """

    offset: tuple[float, float, float] = (0.005, 0.005, 0.01)
    yaw: float = 0.1
    tilt: float = 0.05


SPREAD = GraspSpread()
"""Differences from which a hand still grasps firmly."""


def grasp(
    streams: EpisodeStreams,
    start: Start,
    grip: Array,
    yaw: Array,
    spread: GraspSpread = SPREAD,
) -> Waypoint:
    """The closed hand around an object.

    Args:
        streams: of n episodes.
        start: the object in its place; the arm in the pose of an episode's start.
        grip: [n, 3] m, where the tool holds the object best.
        yaw: [n] rad of the tool's x axis, the fingers close along it.
        spread: how far grasps differ from that.
    """
    offset = streams.uniform(np.array([-1.0, -1.0, 0.0]), 1.0, 3) * spread.offset
    turned = yaw + streams.uniform(-spread.yaw, spread.yaw, 1)[:, 0]
    tilt = streams.normal(spread.tilt, 2)
    return Waypoint(start, grip + offset, tool_rotation(turned, tilt))


def above(streams: EpisodeStreams, start: Start, position: Array) -> Waypoint:
    """The open hand 15 to 25 cm above positions [n, 3] m.

    It is up to 15 cm nearer to the robot than they are, and up to 5 cm aside.
    """
    low, high = np.array([-0.15, -0.05, 0.15]), np.array([0.0, 0.05, 0.25])
    offset = streams.uniform(low, high, 3)
    yaw = REST_YAW + streams.uniform(-0.3, 0.3, 1)[:, 0]
    turned = tool_rotation(yaw, streams.normal(SPREAD.tilt, 2))
    return Waypoint(start, position + offset, turned, closed=False)


def nearest_yaw(yaw: Array, symmetry: int) -> Array:
    """[n] rad: of `symmetry` evenly spaced equivalents of `yaw`, the nearest to rest.

    A hand that turns less stays away from the limits of its wrist.
    """
    period = 2 * np.pi / symmetry
    return yaw - period * np.round((yaw - REST_YAW) / period)
