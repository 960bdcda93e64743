"""How ToolHang is solved."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from manip.envs.task import Measures
from manip.tasks.experts.motion import GAIN, SPIN, UP

Array = np.ndarray

AHEAD = np.array([1.0, 0.0, 0.0])
"""Where the bar of the standing frame points: there the arm reaches all places."""
TILT = 1.0
"""How far [rad] the wrench is turned down on the hook; it slides from 0.6 rad on."""


class Move(NamedTuple):
    """Offset [n, 3] m and turn [n, 3] rad of the hand, and whether to close it [n]."""

    offset: Array
    turn: Array
    close: Array


def tool_hang(m: Measures) -> Array:
    """Stand the frame up in the post, let go, hang the wrench on it, and let go."""
    frame, tool = _fetch(m, "grip", -m["frame_mat"][:, 2::3]), _fetch_tool(m)
    gripped = m["gripper_closing"] > 0.9
    held = frame.close & gripped & (m["frame_left"] > 0) & (m["frame_right"] > 0)
    frame = _choose(held, _stand_up(m), frame)
    tool = _choose(tool.close & gripped & (m["tool_distance"] < 0.03), _hang(m), tool)
    tool = _choose(m["grip_distance"] < 0.1, _leave(m, -m["eef_mat"][:, 2::3]), tool)
    hooked = (np.linalg.norm(m["to_hook"], axis=1) < 0.03) & (m["tool_distance"] > 0.03)
    done = hooked | (_tilt(m) > TILT - 0.08)
    tool = _choose(done, _leave(m, np.tile(UP, (len(done), 1))), tool)
    unseated = held & (m["to_mouth"][:, 2] < 0.147)
    return _action(_choose(m["assembled"] & ~unseated, tool, frame))


def _choose(first: Array, a: Move, b: Move) -> Move:
    offset, turn = (
        np.where(first[:, None], *pair) for pair in zip(a[:2], b[:2], strict=True)
    )
    return Move(offset, turn, np.where(first, a.close, b.close))


def _action(move: Move) -> Array:
    grip = np.where(move.close, 1.0, -1.0)[:, None]
    motion = GAIN * move.offset, SPIN * move.turn
    return np.hstack([*(np.clip(part, -1, 1) for part in motion), grip])


def _leave(m: Measures, way: Array) -> Move:
    """Open where the hand is, then go 10 cm along `way` [n, 3]."""
    opened = (m["gripper_closing"] < -0.5)[:, None]
    return Move(0.1 * way * opened, 0 * way, np.zeros(len(way), bool))


def _fetch(m: Measures, name: str, along: Array) -> Move:
    """From above around a bar that lies `along` [n, 3], close at 1 cm."""
    fingers = _unit(np.cross(along, -UP))
    turn = _turn_to(m["eef_mat"], fingers, np.tile(-UP, (len(fingers), 1)))
    offset, angle = m[f"to_{name}"].copy(), np.linalg.norm(turn, axis=1)
    distance = np.linalg.norm(offset, axis=1)
    kept = (m["gripper_closing"] > -0.9) & (distance < 0.03)
    close = kept | ((distance < 0.01) & (angle < 0.15))
    aside = np.linalg.norm(offset[:, :2], axis=1)
    offset[:, 2] += 0.08 * (~close & ((aside > 0.012) | (angle > 0.15)))
    return Move(offset, turn, close)


def _fetch_tool(m: Measures) -> Move:
    """As any bar; from further than 10 cm, above the height of the standing frame."""
    move = _fetch(m, "tool", -m["tool_mat"][:, ::3])
    far = np.linalg.norm(move.offset[:, :2], axis=1) > 0.1
    move.offset[:, 2] += 0.3 * far
    move.offset[:, :2] *= ~(far & (move.offset[:, 2] > 0.1))[:, None]
    return move


def _stand_up(m: Measures) -> Move:
    """Lift the frame, turn its rod down, then over the post's mouth and into it."""
    ahead = np.tile(AHEAD, (len(m["to_grip"]), 1))
    turn = _turn_to(m["frame_mat"], -ahead, np.tile(UP, (len(ahead), 1)))
    angle, grip = np.linalg.norm(turn, axis=1), m["eef_pos"] + m["to_grip"]
    offset, inside = _insert(m["to_mouth"], angle)
    lying = ((angle > 0.5) & ~inside)[:, None]
    lift = m["tip_pos"] + m["to_mouth"] - grip
    lift[:, 2] = 1.22 - grip[:, 2]
    lift[:, :2] *= grip[:, 2:] > 1.1
    turn = turn * ~(lying & (grip[:, 2:] < 0.9))
    return Move(np.where(lying, lift, offset), turn, np.ones(len(angle), bool))


def _insert(to_mouth: Array, angle: Array) -> tuple[Array, Array]:
    """Offset [n, 3] of the rod into the post; [n], whether its tip is in it.

    The tip goes in first, which is thinner; the rod follows from 4 cm on, once it is
    within 1 mm.
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
    """Lift the wrench, turn it outwards, its hole over the hook, down, and tilt it."""
    offset, depth = m["to_hook"].copy(), m["to_hook"][:, 2]
    aside = np.linalg.norm(offset[:, :2], axis=1)
    on = (depth > -0.001) & (aside < 0.012)
    turn = _tilted(m, TILT * (on & (depth > 0.005)))
    down = (aside < 0.004) & (np.linalg.norm(turn, axis=1) < 0.1)
    above = np.where(down, -0.02, depth + np.where(aside < 0.02, 0.02, 0.08))
    rest = 0.0085 + 0.008 * np.clip(_tilt(m) / 0.7, 0, 1)
    offset[:, 2] = np.where(on, depth - rest, above)
    low = m["tool_pos"][:, 2] < 0.95
    offset[:, :2] *= ~(low | ((depth > -0.04) & (aside > 0.02)))[:, None]
    turn = turn * ~low[:, None]
    return _about_the_hole(m, Move(offset, turn, np.ones(len(low), bool)), on)


def _tilted(m: Measures, angle: Array) -> Array:
    """[n, 3] rad: turn of the wrench to point outwards along the bar, down by angle."""
    bar = _unit(-m["frame_mat"][:, ::3] * [1, 1, 0])
    sin, cos = np.sin(angle)[:, None], np.cos(angle)[:, None]
    return _turn_to(m["tool_mat"], cos * bar - sin * UP, sin * bar + cos * UP)


def _about_the_hole(m: Measures, move: Move, on: Array) -> Move:
    """Once on the hook, turn slowly, and around the hole instead of around the grip."""
    turn = np.where(on[:, None], np.clip(move.turn, -0.075, 0.075), move.turn)
    swing = 2.0 * np.cross(turn, m["tool_pos"] - m["hole_pos"]) * on[:, None]
    return Move(move.offset + swing, turn, move.close)


def _tilt(m: Measures) -> Array:
    """[n] rad: how far the end of the wrench points down."""
    return np.arcsin(np.clip(-m["tool_mat"][:, 6], -1, 1))


def _turn_to(matrix: Array, x: Array, z: Array) -> Array:
    """[n, 3] rad: the turn that brings axes [n, 9] to x and z, each [n, 3]."""
    wanted = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=2))
    return (wanted * Rotation.from_matrix(matrix.reshape(-1, 3, 3)).inv()).as_rotvec()


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
