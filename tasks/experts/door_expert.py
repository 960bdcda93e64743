"""The scripted expert of Door."""

import numpy as np
from scipy.spatial.transform import Rotation

from manip.envs.task import Measures
from manip.tasks.experts.motion import TURN_GAIN, UP, move_action

Array = np.ndarray

LEAN = 0.3
"""Angle [rad] by which the hand leans away from the door."""


def open_door(m: Measures) -> Array:
    """Move over the handle and around it, close, turn it down, pull, keep it open."""
    panel = Rotation.from_quat(m["door_quat"], scalar_first=True).as_matrix()
    along, out = panel[:, :, 0], -panel[:, :, 1]
    offset = m["to_handle"] + 0.015 * out
    around = (m["gripper_closing"] > 0.1) & (m["distance"] < 0.1)
    closing = around | (np.linalg.norm(offset, axis=1) < 0.02)
    offset = np.where(closing[:, None], offset, _over(offset, out))
    angle, ajar = m["handle"][:, None], m["hinge"][:, None]
    turn = -0.1 * (np.sin(angle) * along + np.cos(angle) * UP)
    pull = np.clip(0.37 - ajar, -0.1, 0.1) * out
    work = 0.5 * offset + np.where((angle > 1.25) | (ajar > 0.1), pull, turn)
    shut = m["gripper_closing"][:, None] > 0.9
    action = move_action(np.where(shut, work, offset), np.where(closing, 1.0, -1.0))
    action[:, 3:6] = _turn_to_handle(m["eef_mat"], out)
    return action


def _over(offset: Array, out: Array) -> Array:
    """[n, 3] m: to 8 cm above the handle, or 10 cm in front of it while too low."""
    aside = np.linalg.norm(offset[:, :2], axis=1, keepdims=True)
    offset = offset + np.where(aside > 0.03, 0.08, 0.0) * UP
    low = (aside > 0.05) & (offset[:, 2:] > 0.035)
    return offset + np.where(low, 0.1, 0.0) * out


def _turn_to_handle(eef_mat: Array, out: Array) -> Array:
    """[n, 3]: the action that turns the fingers across the handle, the hand leaning."""
    tool = eef_mat.reshape(-1, 3, 3)
    fingers = np.cos(LEAN) * out - np.sin(LEAN) * UP
    approach = -np.sin(LEAN) * out - np.cos(LEAN) * UP
    error = np.cross(tool[:, :, 0], fingers) + np.cross(tool[:, :, 2], approach)
    return np.clip(TURN_GAIN / 2 * error, -1, 1)
