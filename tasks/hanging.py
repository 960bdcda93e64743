"""ToolHang's objects: where their parts are, and robosuite's tests of what they do.

The stand is a post on a base; the frame a rod with a grip, and a bar with a hook at its
end; the tool a wrench with a grip and a hole at each end. All numbers and tests are
those of robosuite/environments/manipulation/tool_hang.py.
"""

import numpy as np

from manip.envs.task import Measures

Array = np.ndarray

BASE = np.array([0.0, 0.0, -0.075])
"""Centre of the base, from the stand [m]."""
MOUTH = np.array([0.0, 0.045, 0.08])
"""Centre of the post's upper end, from the stand [m]."""
WALLS = np.array(
    [
        [0.0, 0.0395, 0.005],
        [-0.0055, 0.045, 0.005],
        [0.0, 0.0505, 0.005],
        [0.0055, 0.045, 0.005],
    ]
)
"""Centres of the post's walls, from the stand [m], in turn around it."""
CORNER = np.array([0.04375, 0.0, 0.08625])
"""Where rod and bar meet, from the frame [m]."""
GRIP = np.array([0.04375, 0.0, 0.0525])
"""Centre of the frame's grip, from the frame [m]."""
HOOK = np.array([-0.04375, 0.0, 0.102])
"""Upper end of the hook, from the frame [m]."""
RIM = 0.012934313
"""Distance [m] of the ring's sides from the centre of the tool's first hole."""
SLACK = 0.0105 - 0.00375
"""How far [m] the centre of the hole may be from the axis of the bar."""
INSERTED = 0.05
"""Largest distance [m] of the rod's tip from the centre of the base, and smallest part
of the bar that has passed the hole."""
UPRIGHT = np.cos(np.pi / 18)
"""Smallest cosine of the angle between post and vertical."""


def place(position: Array, matrix: Array, local: Array) -> Array:
    """[n, 3] m: a point `local` [3] m of bodies at [n, 3] m, turned by [n, 9]."""
    return position + matrix.reshape(-1, 3, 3) @ local


def assembled(m: Measures) -> Array:
    """[n] bool: the frame stands in the upright post (stock `_check_frame_assembled`).

    Of the measures, takes stand_pos, stand_mat and the frame's tip_pos, mount_pos and
    corner_pos: the ends of the rod, without and with its tip, and of the bar.
    """
    base = place(m["stand_pos"], m["stand_mat"], BASE)
    deep = np.linalg.norm(m["tip_pos"] - base, axis=1) < INSERTED
    rod = m["corner_pos"] - m["mount_pos"]
    walls = [place(m["stand_pos"], m["stand_mat"], wall) for wall in WALLS]
    a, b, c, d = (wall - m["mount_pos"] for wall in walls)
    between = _apart(a, c, rod) & _apart(b, d, rod)
    return (m["stand_mat"][:, 8] > UPRIGHT) & deep & between


def threaded(m: Measures) -> Array:
    """[n] bool: the bar runs through the hole (stock `_check_tool_on_frame`, 3 to 5).

    Of the measures, takes tool_mat, hole_pos, and the bar's ends hang_pos, corner_pos.
    """
    bar, hole = m["corner_pos"] - m["hang_pos"], m["hole_pos"] - m["hang_pos"]
    passed = (hole * bar).sum(axis=1) / (bar * bar).sum(axis=1)
    aside = np.linalg.norm(hole - passed[:, None] * bar, axis=1)
    rim = RIM * m["tool_mat"][:, [0, 3, 6]]
    around = _apart(hole - rim, hole + rim, bar)
    return (aside < SLACK) & around & (passed > INSERTED) & (passed < 1)


def _apart(a: Array, b: Array, line: Array) -> Array:
    """[n] bool: two points [n, 3] are opposite each other across a line [n, 3]."""
    return (np.cross(a, line) * np.cross(b, line)).sum(axis=1) < 0
