"""The scripted expert of Stack."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.motion import TURN_GAIN, UP, move_action
from manip.tasks.rotations import rotation_matrix, yaw_angle

Array = np.ndarray


def stack_cubes(m: Measures, height: float) -> Array:
    """Align with A, close, lift, move over B, lower, and open once A rests on B.

    height: of A's centre above B's when A lies on B [m].
    """
    offset, turn = m["to_a"].copy(), _yaw_to(m, rotation_matrix(m["a_quat"]))
    apart = (np.linalg.norm(offset[:, :2], axis=1) > 0.01) | (np.abs(turn) > 0.1)
    around = (m["distance"] < 0.02) & (m["gripper_closing"] > 0.1)
    closing = (m["grasped"] | around | (m["distance"] < 0.012)) & ~m["on"]
    offset[:, 2] += np.where(apart & ~closing, 0.06, 0.0)
    carried = m["grasped"] & (m["gripper_closing"] > 0.9)
    offset = np.where(carried[:, None], _onto(-m["from_b"] + height * UP), offset)
    leave = np.where(m["gripper_closing"] < -0.5, 0.1, 0.0)[:, None] * UP
    offset = np.where(m["on"][:, None], leave, offset)
    action = move_action(offset, np.where(closing, 1.0, -1.0))
    action[:, 5] = np.clip(TURN_GAIN * turn, -1, 1) * ~m["on"]
    return action


def _onto(offset: Array) -> Array:
    """[n, 3] m: to 3 cm above B, then down once A is less than 8 mm aside."""
    aside, below = np.linalg.norm(offset[:, :2], axis=1), offset[:, 2]
    down = (aside < 0.008) | ((aside < 0.015) & (below > -0.025))
    offset[:, :2] *= (below < -0.015)[:, None] | down[:, None]
    offset[:, 2] = np.where(down, below - 0.005, below + 0.03)
    return offset


def _yaw_to(m: Measures, matrix: Array) -> Array:
    """[n] rad: the smallest yaw that aligns the fingers with a cube's faces."""
    error = yaw_angle(matrix) - yaw_angle(m["eef_mat"])
    return error - np.pi / 2 * np.round(error / (np.pi / 2))
