"""How Stack is solved."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.motion import SPIN, UP, towards
from manip.tasks.objects import rotation, yaw

Array = np.ndarray


def stack(m: Measures, height: float) -> Array:
    """Around A as it is turned, close, up, over B, down, and open once it rests.

    height: of A's centre above B's then [m].
    """
    offset, turn = m["to_a"].copy(), _quarter(yaw(rotation(m["a_quat"])), m)
    apart = (np.linalg.norm(offset[:, :2], axis=1) > 0.01) | (np.abs(turn) > 0.1)
    kept = m["grasped"] | ((m["distance"] < 0.02) & (m["gripper_closing"] > 0.1))
    closing = (kept | (m["distance"] < 0.012)) & ~m["on"]
    offset[:, 2] += np.where(apart & ~closing, 0.06, 0.0)
    carried = m["grasped"] & (m["gripper_closing"] > 0.9)
    offset = np.where(carried[:, None], _onto(-m["from_b"] + height * UP), offset)
    leave = np.where(m["gripper_closing"] < -0.5, 0.1, 0.0)[:, None] * UP
    offset = np.where(m["on"][:, None], leave, offset)
    action = towards(offset, np.where(closing, 1.0, -1.0))
    action[:, 5] = np.clip(SPIN * turn, -1, 1) * ~m["on"]
    return action


def _onto(offset: Array) -> Array:
    """3 cm above the place, then down once it is less than 8 mm aside."""
    aside, below = np.linalg.norm(offset[:, :2], axis=1), offset[:, 2]
    down = (aside < 0.008) | ((aside < 0.015) & (below > -0.025))
    offset[:, :2] *= (below < -0.015)[:, None] | down[:, None]
    offset[:, 2] = np.where(down, below - 0.005, below + 0.03)
    return offset


def _quarter(angle: Array, m: Measures) -> Array:
    """Smallest turn [rad] of the tool that brings it to `angle`, give or take 90°."""
    error = angle - yaw(m["eef_mat"])
    return error - np.pi / 2 * np.round(error / (np.pi / 2))
