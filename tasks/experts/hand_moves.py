"""Batched moves of the hand, which the expert of ToolHang chooses among."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from manip.envs.task import Measures
from manip.tasks.experts.motion import GAIN, TURN_GAIN, UP

Array = np.ndarray


class Move(NamedTuple):
    """A move of the hand in n environments.

    offset [n, 3] m; turn [n, 3] rad, a rotation vector; close [n] bool: the gripper.
    """

    offset: Array
    turn: Array
    close: Array


def choose(condition: Array, if_true: Move, if_false: Move) -> Move:
    """The move `if_true` where condition [n] holds, else `if_false`."""
    return Move(
        np.where(condition[:, None], if_true.offset, if_false.offset),
        np.where(condition[:, None], if_true.turn, if_false.turn),
        np.where(condition, if_true.close, if_false.close),
    )


def as_action(move: Move) -> Array:
    """[n, 7]: the OSC_POSE action of a move."""
    grip = np.where(move.close, 1.0, -1.0)[:, None]
    motion = GAIN * move.offset, TURN_GAIN * move.turn
    return np.hstack([*(np.clip(part, -1, 1) for part in motion), grip])


def leave(m: Measures, direction: Array) -> Move:
    """Open the gripper in place, then move 10 cm along `direction` [n, 3]."""
    opened = (m["gripper_closing"] < -0.5)[:, None]
    no_turn = 0 * direction
    return Move(0.1 * direction * opened, no_turn, np.zeros(len(direction), bool))


def fetch_bar(m: Measures, offset: Array, along: Array) -> Move:
    """Take a bar from above and close at 1 cm.

    offset [n, 3] m: from the gripper to the grip; along [n, 3]: direction of the bar.
    """
    fingers = unit(np.cross(along, -UP))
    turn = turn_to(m["eef_mat"], fingers, np.tile(-UP, (len(fingers), 1)))
    offset, angle = offset.copy(), np.linalg.norm(turn, axis=1)
    distance = np.linalg.norm(offset, axis=1)
    around = (m["gripper_closing"] > -0.9) & (distance < 0.03)
    close = around | ((distance < 0.01) & (angle < 0.15))
    aside = np.linalg.norm(offset[:, :2], axis=1)
    offset[:, 2] += 0.08 * (~close & ((aside > 0.012) | (angle > 0.15)))
    return Move(offset, turn, close)


def turn_to(matrix: Array, x: Array, z: Array) -> Array:
    """[n, 3] rad: rotation vector that turns axes [n, 9] to x and z, each [n, 3]."""
    goal = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=2))
    return (goal * Rotation.from_matrix(matrix.reshape(-1, 3, 3)).inv()).as_rotvec()


def unit(vectors: Array) -> Array:
    """[n, 3]: the vectors, scaled to length 1."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
