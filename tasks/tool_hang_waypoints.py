"""ToolHang: its waypoints, from the frame in the hand to the wrench on the hook.

grasp_frame: the frame lies where it starts, in the closed hand. upright: it stands in
the air, between its start and the post. insert: its tip is in the post, too high for
`assembled`. assembled: it stands in the post, and the open hand is 4 to 12 cm behind
its grip. In all others, it stands as well. near_tool: the open hand is above the grip
of the wrench. grasp_tool: the wrench lies where it starts, in the closed hand. carry:
its hole is above the hook. hang: the frame's bar runs through its hole.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Start, Waypoint
from manip.tasks.tool_hang_measures import GRIP

Array = np.ndarray
Interval = tuple[float, float]

NAMES = (
    *("grasp_frame", "upright", "insert", "assembled"),
    *("near_tool", "grasp_tool", "carry", "hang"),
)
GRIP_STANDING = np.array([-0.08, 0.045, 0.998])
"""Position [m] of the grip of the frame that stands in the post, its tip on the base
(robosuite/environments/manipulation/tool_hang.py)."""
HOLE = np.array([-0.0935, 0.0, 0.0])
"""Centre of the wrench's first hole, in its own frame [m] (ibid.)."""
RAISED = (0.025, 0.138)
"""Least and greatest height [m] above this of a frame whose tip is in the post."""
HEIGHTS = (1.03, 1.25)
"""Least and greatest height [m] of the grip of the frame upright in the air."""
PLAY = 0.0005
"""Largest distance [m], in x and y, of the rod from the axis of the post."""
HOLE_AT = {
    "carry": ((-0.056, -0.012, 0.108), (-0.032, 0.012, 0.122), (0.0, 0.0)),
    "hang": ((-0.034, -0.001, 0.0843), (-0.014, 0.001, 0.0863), (0.75, 0.95)),
}
"""Corners [m] of the box of the wrench's hole, in the frame's own frame, and the least
and greatest tilt [rad]: above the hook at (-0.044, 0, 0.102), or around the bar, whose
axis is at (x, 0, 0.086). The bar has room in the tilted ring from 0.7 rad on; the arm
does not reach 1 rad."""


class Hold(NamedTuple):
    """Where the hand is from the grip of an object.

    Attributes:
        across, along, ahead: least and greatest distance [m] of the tool from the grip,
            along its own axes: in which the fingers close, along the grip, and to which
            the hand points.
        turn: standard deviation [rad] of its turn about each axis.
        closed: whether the gripper is closed around the object.
    """

    across: Interval = (-0.003, 0.003)
    along: Interval = (-0.01, 0.01)
    ahead: Interval = (-0.008, 0.002)
    turn: float = 0.04
    closed: bool = True


HOLDS = {
    "assembled": Hold(ahead=(-0.12, -0.04), closed=False),
    "near_tool": Hold((-0.015, 0.015), (-0.02, 0.02), (-0.025, 0.0), 0.08, False),
}
"""Holds of the waypoints at which the hand is open."""
AT_FRAME = Rotation.from_matrix([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
"""The hand that has taken the lying frame from above, in the frame's own frame."""
AT_TOOL = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""The hand that has taken the lying wrench from above, in its own frame. So turned, it
reaches the hook; turned by half a circle, it seldom does."""


def place_parts(
    milestone: str, streams: EpisodeStreams, start: Start, frame: slice, tool: slice
) -> Waypoint:
    """Put frame, wrench and hand to where they are at a milestone.

    start: frame and wrench are at their starts.

    frame, tool: entries of their free bodies in qpos.
    """
    qpos, hold = start.qpos, HOLDS.get(milestone, Hold())
    qpos[:, frame] = _frame_pose(milestone, streams, qpos[:, frame])
    if milestone in ("grasp_frame", "upright", "insert", "assembled"):
        return _hand_at(streams, start, qpos[:, frame], GRIP, AT_FRAME, hold)
    qpos[:, tool] = _tool_pose(milestone, streams, qpos[:, tool], qpos[:, frame])
    return _hand_at(streams, start, qpos[:, tool], np.zeros(3), AT_TOOL, hold)


def _hand_at(
    streams: EpisodeStreams,
    start: Start,
    pose: Array,
    grip: Array,
    hand: Rotation,
    hold: Hold,
) -> Waypoint:
    """The hand at the grip [3] m, in the own frame of a body at `pose` [n, 7]."""
    body = Rotation.from_quat(pose[:, 3:], scalar_first=True)
    turned = body * hand * Rotation.from_rotvec(streams.normal(hold.turn, 3))
    low, high = np.transpose([hold.across, hold.along, hold.ahead])
    offset = turned.apply(streams.uniform(low, high, 3))
    position = pose[:, :3] + body.apply(grip) + offset
    return Waypoint(start, position, turned.as_matrix().reshape(-1, 9), hold.closed)


def _frame_pose(milestone: str, streams: EpisodeStreams, first: Array) -> Array:
    """[n, 7]: qpos of the frame; `first` [n, 7] at its start."""
    if milestone == "grasp_frame":
        return first
    if milestone == "upright":
        return _in_the_air(streams, first)
    lift = RAISED if milestone == "insert" else (0.0, 0.0005)
    low, high = np.transpose([(-PLAY, PLAY), (-PLAY, PLAY), lift])
    grip = GRIP_STANDING + streams.uniform(low, high, 3)
    turn = np.pi + streams.uniform(-0.03, 0.03, 1)
    return _pose(grip, GRIP, Rotation.from_euler("z", turn))


def _in_the_air(streams: EpisodeStreams, first: Array) -> Array:
    """[n, 7]: the frame upright, between its start and the post."""
    lying = Rotation.from_quat(first[:, 3:], scalar_first=True)
    begin = first[:, :3] + lying.apply(GRIP)
    grip = begin + (GRIP_STANDING - begin) * streams.uniform(0, 1, 1)
    grip[:, 2] = streams.uniform(*HEIGHTS, 1)[:, 0]
    yaw, tilt = np.pi + streams.uniform(-0.3, 0.3, 1), streams.normal(0.06, 2)
    return _pose(grip, GRIP, Rotation.from_euler("zyx", np.hstack([yaw, tilt])))


def _tool_pose(
    milestone: str, streams: EpisodeStreams, first: Array, frame: Array
) -> Array:
    """[n, 7]: qpos of the wrench; `first` [n, 7] at its start; frame [n, 7] stands."""
    if milestone not in HOLE_AT:
        return first
    stand = Rotation.from_quat(frame[:, 3:], scalar_first=True)
    low, high, tilts = HOLE_AT[milestone]
    spot = streams.uniform(np.array(low), np.array(high), 3)
    hole = frame[:, :3] + stand.apply(spot)
    yaw = np.pi + streams.uniform(-0.1, 0.1, 1)
    outwards = np.hstack([yaw, -streams.uniform(*tilts, 1)])
    return _pose(hole, HOLE, stand * Rotation.from_euler("zy", outwards))


def _pose(position: Array, point: Array, turn: Rotation) -> Array:
    """[n, 7]: qpos of bodies of which a `point` [3] m is at `position` [n, 3] m."""
    return np.hstack([position - turn.apply(point), turn.as_quat(scalar_first=True)])
