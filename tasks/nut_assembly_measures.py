"""NutAssembly: where the nut is from the tool and from its peg."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.arm import both_pads_touch
from manip.tasks.rotations import rotation_matrix, yaw_angle

Array = np.ndarray

TABLE = 0.82
"""Height [m] of the table (robosuite/environments/manipulation/nut_assembly.py)."""
REST = 0.83
"""Height [m] of the centre of a nut that lies on the table."""
TOP = 0.95
"""Height [m] of the pegs' tops (robosuite/models/assets/arenas/pegs_arena.xml)."""
SUCCESS_HEIGHT = TABLE + 0.05
"""Height [m] of the nut's centre below which it is on its peg (nut_assembly.py)."""
BESIDE = 0.03
"""Largest distance [m] of the nut from its peg, in x and y, for success (ibid.)."""
CLEAR = 0.1 * np.arctanh(0.4)
"""Smallest distance [m] of the nut's centre from the tool, for success (ibid.)."""
GRASP_DISTANCE = 0.02
"""Largest distance [m] of the tool from the handle in a firm grasp."""


def measure_nut(read: Measures) -> dict[str, Array]:
    """Add offsets and angles between the tool, the nut and its peg, and the grasp.

    to_handle [N, 3] m from the tool; distance [N] m, its length; to_peg [N, 3] m from
    the nut's centre to the peg's; aside [N] m, its horizontal length; height [N] m of
    the nut's centre; nut_mat [N, 9], its rotation; handle_turn [N] rad by which the
    tool must yaw to lie across the handle; grasped [N] bool, robosuite's test;
    firm_grasp [N] bool, with the tool at the handle.
    """
    to_handle = read["handle_pos"] - read["eef_pos"]
    to_peg = read["peg_pos"] - read["nut_pos"]
    distance = np.linalg.norm(to_handle, axis=1)
    grasped, nut_mat = both_pads_touch(read), rotation_matrix(read["nut_quat"])
    return {
        **read,
        "to_handle": to_handle,
        "distance": distance,
        "to_peg": to_peg,
        "aside": np.hypot(*to_peg[:, :2].T),
        "height": read["nut_pos"][:, 2],
        "nut_mat": nut_mat,
        "handle_turn": yaw_angle(nut_mat) + np.pi / 2 - yaw_angle(read["eef_mat"]),
        "grasped": grasped,
        "firm_grasp": grasped & (distance < GRASP_DISTANCE),
    }


def on_peg_and_clear(m: Measures) -> Array:
    """[N] bool: the nut is low, at its peg, and its centre away from the tool."""
    beside = (np.abs(m["to_peg"][:, :2]) < BESIDE).all(axis=1)
    clear = np.linalg.norm(m["nut_pos"] - m["eef_pos"], axis=1) > CLEAR
    return beside & (m["height"] < SUCCESS_HEIGHT) & clear
