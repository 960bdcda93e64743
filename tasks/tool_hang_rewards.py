"""ToolHang: the terms of its rewards.

Shaped reward, in [0, 1] per step. For the frame: 0.05 reach_frame + 0.05 grasp_frame
    + 0.05 lift_frame + 0.1 upright + 0.1 over + 0.15 insert. Once the frame stands,
    these are 1, and for the wrench: 0.05 leave + 0.05 reach_tool + 0.1 grasp_tool
    + 0.15 carry + 0.05 hang + 0.05 release + 0.05 stay.
    reach_frame, reach_tool: 1 - tanh(5 d) of the distance d [m] to the grip.
    grasp_frame, grasp_tool: rise as the gripper's command goes from open to closed.
    lift_frame: rises linearly with the grip's height, over 14 cm.
    upright: lift_frame times how far the rod is turned downwards.
    over: upright times the nearness of the rod's tip to the post's mouth. Half of it
        falls linearly over 50 cm, half within 5 cm.
    insert: the depth of the tip in the post.
    leave: rises as the gripper opens or moves away from the frame.
    carry: the nearness of the wrench's hole to the hook.
    hang: 1 while the frame's bar runs through the hole. Then the terms from reach_tool
        to carry are 1 as well.
    release: while the wrench hangs, rises as the command goes from closed to open.
    stay: 1 on success. Then all terms are 1.
    The terms from grasp_frame to insert need a firm grasp of the frame, grasp_tool and
    carry one of the wrench: both finger pads touch it and d < 3 cm.

The frame lies flat on the table and cannot turn there, so lifting pays on its own.
"""

import numpy as np

from manip.envs.task import Measures, Weights
from manip.rewards.kernels import near, ramp
from manip.tasks.tool_hang_measures import GRASP_DISTANCE, POST_DEPTH, tip_depth

Array = np.ndarray

LIES, STANDS = 0.85, 0.99
"""Heights [m] of the frame's grip, just above where it lies, below where it stands."""

WEIGHTS: Weights = {
    "shaped": {
        "reach_frame": 0.05,
        "grasp_frame": 0.05,
        "lift_frame": 0.05,
        "upright": 0.1,
        "over": 0.1,
        "insert": 0.15,
        "leave": 0.05,
        "reach_tool": 0.05,
        "grasp_tool": 0.1,
        "carry": 0.15,
        "hang": 0.05,
        "release": 0.05,
        "stay": 0.05,
    },
    "stock": {"success": 1.0},
}


def shaped_terms(m: Measures, success: Array) -> dict[str, Array]:
    """Terms [N] of the shaped reward; see the module's docstring."""
    stands = m["assembled"]
    tool = {"leave": _left_frame(m), **_tool_terms(m, success)}
    return {
        **{name: np.maximum(stands, term) for name, term in _frame_terms(m).items()},
        **{name: np.maximum(success, stands * term) for name, term in tool.items()},
    }


def _frame_terms(m: Measures) -> dict[str, Array]:
    grasp = m["frame_firm_grasp"].astype(float)
    lifted = grasp * ramp(m["eef_pos"][:, 2] + m["to_grip"][:, 2], LIES, STANDS)
    upright = lifted * (1 + m["frame_mat"][:, 8]) / 2
    return {
        "reach_frame": near(m["grip_distance"], 0.2),
        "grasp_frame": grasp * ramp(m["gripper_closing"], -1.0, 1.0),
        "lift_frame": lifted,
        "upright": upright,
        "over": upright * np.maximum(_at_mouth(m), tip_depth(m) > 0),
        "insert": grasp * ramp(tip_depth(m), 0.0, POST_DEPTH),
    }


def _at_mouth(m: Measures) -> Array:
    """[N] in [0, 1]: nearness of the rod's tip to the post's mouth, coarse and fine."""
    distance = np.linalg.norm(m["to_mouth"], axis=1)
    return (1 - ramp(distance, 0.0, 0.5) + near(distance, 0.05)) / 2


def _left_frame(m: Measures) -> Array:
    """[N] in [0, 1]: how far the gripper has opened, or moved away from the frame."""
    opened = ramp(-m["gripper_closing"], -1.0, 1.0)
    away = ramp(m["grip_distance"], GRASP_DISTANCE, 2 * GRASP_DISTANCE)
    return np.maximum(opened, away)


def _tool_terms(m: Measures, success: Array) -> dict[str, Array]:
    grasp, on_bar = m["tool_firm_grasp"], m["threaded"]
    closing = ramp(m["gripper_closing"], -1.0, 1.0)
    carry = grasp * near(np.linalg.norm(m["to_hook"], axis=1), 0.2)
    return {
        "reach_tool": np.maximum(on_bar, near(m["tool_distance"], 0.2)),
        "grasp_tool": np.maximum(on_bar, grasp * closing),
        "carry": np.maximum(on_bar, carry),
        "hang": on_bar.astype(float),
        "release": on_bar * ramp(-m["gripper_closing"], -1.0, 1.0),
        "stay": success.astype(float),
    }


def stock_terms(m: Measures, success: Array) -> dict[str, Array]:
    """Terms [N] of robosuite's reward, which has no shaping."""
    return {"success": success.astype(float)}


TERMS = {"shaped": shaped_terms, "stock": stock_terms}
