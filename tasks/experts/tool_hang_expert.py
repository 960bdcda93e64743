"""The scripted expert of ToolHang."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.hand_moves import (
    Move,
    as_action,
    choose,
    fetch_bar,
    leave,
    turn_to,
    unit,
)
from manip.tasks.experts.motion import UP

Array = np.ndarray

AHEAD = np.array([1.0, 0.0, 0.0])
"""Direction of the standing frame's bar. The arm reaches every position this way."""
TILT = 1.0
"""Angle [rad] by which the wrench is tilted on the hook; it slides from 0.6 rad on."""


def hang_tool(m: Measures) -> Array:
    """Insert the frame into the stand, then hang the wrench on it; release both."""
    frame = fetch_bar(m, m["to_grip"], along=-m["frame_mat"][:, 2::3])
    touches = (m["frame_left"] > 0) & (m["frame_right"] > 0)
    grasped = frame.close & (m["gripper_closing"] > 0.9) & touches
    frame = choose(grasped, _stand_up(m), frame)
    unseated = grasped & (m["to_mouth"][:, 2] < 0.147)
    return as_action(choose(m["assembled"] & ~unseated, _move_tool(m), frame))


def _move_tool(m: Measures) -> Move:
    """Leave the frame, fetch the wrench, hang it on the hook, and leave it."""
    move = _fetch_tool(m)
    grasped = move.close & (m["gripper_closing"] > 0.9) & (m["tool_distance"] < 0.03)
    move = choose(grasped, _hang(m), move)
    at_frame = m["grip_distance"] < 0.1
    move = choose(at_frame, leave(m, -m["eef_mat"][:, 2::3]), move)
    hooked = (np.linalg.norm(m["to_hook"], axis=1) < 0.03) & (m["tool_distance"] > 0.03)
    done = hooked | (_tilt(m) > TILT - 0.08)
    return choose(done, leave(m, np.tile(UP, (len(done), 1))), move)


def _fetch_tool(m: Measures) -> Move:
    """As any bar, but above the height of the standing frame while 10 cm away."""
    move = fetch_bar(m, m["to_tool"], along=-m["tool_mat"][:, ::3])
    far = np.linalg.norm(move.offset[:, :2], axis=1) > 0.1
    move.offset[:, 2] += 0.3 * far
    move.offset[:, :2] *= ~(far & (move.offset[:, 2] > 0.1))[:, None]
    return move


def _stand_up(m: Measures) -> Move:
    """Lift the frame, turn its rod down, move it over the post's mouth and into it."""
    ahead = np.tile(AHEAD, (len(m["to_grip"]), 1))
    turn = turn_to(m["frame_mat"], -ahead, np.tile(UP, (len(ahead), 1)))
    angle, grip = np.linalg.norm(turn, axis=1), m["eef_pos"] + m["to_grip"]
    offset, inside = _insert(m["to_mouth"], angle)
    lying = ((angle > 0.5) & ~inside)[:, None]
    lift = m["tip_pos"] + m["to_mouth"] - grip
    lift[:, 2] = 1.22 - grip[:, 2]
    lift[:, :2] *= grip[:, 2:] > 1.1
    turn = turn * ~(lying & (grip[:, 2:] < 0.9))
    return Move(np.where(lying, lift, offset), turn, np.ones(len(angle), bool))


def _insert(to_mouth: Array, angle: Array) -> tuple[Array, Array]:
    """Offset [n, 3] m that moves the rod into the post; [n] bool: its tip is inside.

    The tip is thinner than the rod. The rod follows from 4 cm of depth on, once it is
    within 1 mm of the axis.
    """
    offset, depth = to_mouth.copy(), to_mouth[:, 2]
    aside = np.linalg.norm(offset[:, :2], axis=1)
    inside = (depth > 0.004) & (np.abs(offset[:, :2]).max(axis=1) < 0.0045)
    above = np.where((aside < 0.0025) & (angle < 0.06), -0.012, depth + 0.012)
    tip = np.where(aside > 0.001, np.clip(depth - 0.038, -0.02, 0.02), -0.015)
    down = np.where(depth < 0.05, tip, -0.03)
    offset[:, 2] = np.where(inside, down, above)
    offset[:, :2] *= np.where(inside & (depth > 0.05), 0.3, 1.0)[:, None]
    return offset, inside


def _hang(m: Measures) -> Move:
    """Lift the wrench, turn it outwards, put its hole over the hook, and tilt it."""
    offset, depth = m["to_hook"].copy(), m["to_hook"][:, 2]
    aside = np.linalg.norm(offset[:, :2], axis=1)
    on_hook = (depth > -0.001) & (aside < 0.012)
    turn = _outwards(m, TILT * (on_hook & (depth > 0.005)))
    down = (aside < 0.004) & (np.linalg.norm(turn, axis=1) < 0.1)
    above = np.where(down, -0.02, depth + np.where(aside < 0.02, 0.02, 0.08))
    rest = 0.0085 + 0.008 * np.clip(_tilt(m) / 0.7, 0, 1)
    offset[:, 2] = np.where(on_hook, depth - rest, above)
    low = m["tool_pos"][:, 2] < 0.95
    offset[:, :2] *= ~(low | ((depth > -0.04) & (aside > 0.02)))[:, None]
    turn = turn * ~low[:, None]
    return _about_hole(m, Move(offset, turn, np.ones(len(low), bool)), on_hook)


def _outwards(m: Measures, tilt: Array) -> Array:
    """[n, 3] rad: turns the wrench outwards along the bar, and down by `tilt` [n]."""
    bar = unit(-m["frame_mat"][:, ::3] * [1, 1, 0])
    sin, cos = np.sin(tilt)[:, None], np.cos(tilt)[:, None]
    return turn_to(m["tool_mat"], cos * bar - sin * UP, sin * bar + cos * UP)


def _about_hole(m: Measures, move: Move, on_hook: Array) -> Move:
    """On the hook [n], turn slowly, and around the hole instead of the grip."""
    turn = np.where(on_hook[:, None], np.clip(move.turn, -0.075, 0.075), move.turn)
    swing = 2.0 * np.cross(turn, m["tool_pos"] - m["hole_pos"]) * on_hook[:, None]
    return Move(move.offset + swing, turn, move.close)


def _tilt(m: Measures) -> Array:
    """[n] rad: how far the end of the wrench points down."""
    return np.arcsin(np.clip(-m["tool_mat"][:, 6], -1, 1))
