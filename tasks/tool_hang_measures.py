"""ToolHang: where its parts are, and robosuite's tests of success.

The stand is a post on a base. The frame is a rod with a grip, and a bar with a hook at
its end. The tool is a wrench with a grip, and a hole at each end. All numbers and tests
are those of robosuite/environments/manipulation/tool_hang.py.
"""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.rotations import rotation_matrix

Array = np.ndarray

BASE = np.array([0.0, 0.0, -0.075])
"""Centre of the base, in the stand's frame [m]."""
MOUTH = np.array([0.0, 0.045, 0.08])
"""Centre of the post's upper end, in the stand's frame [m]."""
WALLS = np.array(
    [
        [0.0, 0.0395, 0.005],
        [-0.0055, 0.045, 0.005],
        [0.0, 0.0505, 0.005],
        [0.0055, 0.045, 0.005],
    ]
)
"""Centres of the post's walls, in the stand's frame [m], in order around the post."""
CORNER = np.array([0.04375, 0.0, 0.08625])
"""Where rod and bar meet, in the frame's own frame [m]."""
GRIP = np.array([0.04375, 0.0, 0.0525])
"""Centre of the frame's grip, in the frame's own frame [m]."""
HOOK = np.array([-0.04375, 0.0, 0.102])
"""Upper end of the hook, in the frame's own frame [m]."""
RIM = 0.012934313
"""Distance [m] of the ring's sides from the centre of the tool's first hole."""
MAX_OFFSET = 0.0105 - 0.00375
"""Largest distance [m] of the hole's centre from the axis of the bar."""
INSERTED = 0.05
"""Largest distance [m] of the rod's tip from the centre of the base. It is also the
smallest fraction of the bar that has passed the hole."""
UPRIGHT = np.cos(np.pi / 18)
"""Smallest cosine of the angle between post and vertical."""
BODIES = ("stand", "frame", "tool")
"""Bodies whose rotation is measured."""
GRASP_DISTANCE = 0.03
"""Largest distance [m] of the gripper from a grip's centre in a firm grasp."""
POST_DEPTH = 0.15
"""Depth [m] of the post."""
BORE = 0.005
"""Half width [m] of the post's inside."""
FINGERS = ("left_fingerpad", "right_fingerpad", "left_finger", "right_finger")
"""Parts of a gripper that must not touch the wrench for success."""


def measure_parts(read: Measures) -> dict[str, Array]:
    """Add rotations of stand, frame and wrench, offsets, grasps, and what stands.

    stand_mat, frame_mat, tool_mat [N, 9]; to_grip, to_tool [N, 3] m from the gripper to
    the grips of frame and wrench; grip_distance, tool_distance [N] m, their lengths;
    to_mouth [N, 3] m from the rod's tip to the post's mouth; to_hook [N, 3] m from the
    wrench's hole to the hook; frame_firm_grasp, tool_firm_grasp [N] bool: both finger
    pads touch it, and the gripper is at its grip; assembled, threaded [N] bool: see the
    functions of these names; hung [N] bool: the wrench hangs on the frame, ungrasped.
    """
    mats = {f"{b}_mat": rotation_matrix(read[f"{b}_quat"]) for b in BODIES}
    m = {**read, **mats}
    m["to_grip"] = point_of(m["frame_pos"], m["frame_mat"], GRIP) - m["eef_pos"]
    m["to_tool"] = m["tool_pos"] - m["eef_pos"]
    m["grip_distance"] = np.linalg.norm(m["to_grip"], axis=1)
    m["tool_distance"] = np.linalg.norm(m["to_tool"], axis=1)
    m["to_mouth"] = point_of(m["stand_pos"], m["stand_mat"], MOUTH) - m["tip_pos"]
    m["to_hook"] = point_of(m["frame_pos"], m["frame_mat"], HOOK) - m["hole_pos"]
    touched = (m["frame_left"] > 0) & (m["frame_right"] > 0)
    m["frame_firm_grasp"] = touched & (m["grip_distance"] < GRASP_DISTANCE)
    touched = (m["tool_left_fingerpad"] > 0) & (m["tool_right_fingerpad"] > 0)
    m["tool_firm_grasp"] = touched & (m["tool_distance"] < GRASP_DISTANCE)
    m["assembled"], m["threaded"] = assembled(m), threaded(m)
    fingers = np.any([m[f"tool_{finger}"] > 0 for finger in FINGERS], axis=0)
    m["hung"] = m["threaded"] & (m["hole_touch"] > 0) & ~fingers
    return m


def point_of(position: Array, matrix: Array, local: Array) -> Array:
    """[n, 3] m: world position of a point `local` [3] m of bodies.

    position [n, 3] m and matrix [n, 9] of the bodies.
    """
    return position + matrix.reshape(-1, 3, 3) @ local


def assembled(m: Measures) -> Array:
    """[n] bool: the frame stands in the upright post (`_check_frame_assembled`).

    Reads stand_pos, stand_mat and the frame's tip_pos, mount_pos and corner_pos: the
    ends of the rod, with and without its tip, and of the bar.
    """
    base = point_of(m["stand_pos"], m["stand_mat"], BASE)
    deep = np.linalg.norm(m["tip_pos"] - base, axis=1) < INSERTED
    rod = m["corner_pos"] - m["mount_pos"]
    walls = [point_of(m["stand_pos"], m["stand_mat"], wall) for wall in WALLS]
    a, b, c, d = (wall - m["mount_pos"] for wall in walls)
    between = _opposite(a, c, rod) & _opposite(b, d, rod)
    return (m["stand_mat"][:, 8] > UPRIGHT) & deep & between


def threaded(m: Measures) -> Array:
    """[n] bool: the bar runs through the hole (`_check_tool_on_frame`, 3 to 5).

    Reads tool_mat, hole_pos, and the bar's ends hang_pos and corner_pos.
    """
    bar, hole = m["corner_pos"] - m["hang_pos"], m["hole_pos"] - m["hang_pos"]
    passed = (hole * bar).sum(axis=1) / (bar * bar).sum(axis=1)
    aside = np.linalg.norm(hole - passed[:, None] * bar, axis=1)
    rim = RIM * m["tool_mat"][:, [0, 3, 6]]
    around = _opposite(hole - rim, hole + rim, bar)
    return (aside < MAX_OFFSET) & around & (passed > INSERTED) & (passed < 1)


def _opposite(a: Array, b: Array, line: Array) -> Array:
    """[n] bool: two points [n, 3] are on opposite sides of a line [n, 3]."""
    return (np.cross(a, line) * np.cross(b, line)).sum(axis=1) < 0


def tip_depth(m: Measures) -> Array:
    """[N] m: depth of the rod's tip in the post, 0 where it is beside the post."""
    inside = (np.abs(m["to_mouth"][:, :2]) < BORE).all(axis=1)
    return inside * np.maximum(m["to_mouth"][:, 2], 0.0)
