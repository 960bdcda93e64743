"""How Door is solved."""

import numpy as np
from scipy.spatial.transform import Rotation

from manip.envs.task import Measures
from manip.tasks.experts.motion import SPIN, UP, towards

Array = np.ndarray


def door(m: Measures) -> Array:
    """Over the handle and around it, close, turn it down, pull, and hold it open."""
    panel = Rotation.from_quat(m["door_quat"], scalar_first=True).as_matrix()
    along, out = panel[:, :, 0], -panel[:, :, 1]
    offset = m["to_handle"] + 0.015 * out
    kept = (m["gripper_closing"] > 0.1) & (m["distance"] < 0.1)
    closing = kept | (np.linalg.norm(offset, axis=1) < 0.02)
    offset = np.where(closing[:, None], offset, _over(offset, out))
    angle, ajar = m["handle"][:, None], m["hinge"][:, None]
    turn = -0.1 * (np.sin(angle) * along + np.cos(angle) * UP)
    pull = np.clip(0.37 - ajar, -0.1, 0.1) * out
    work = 0.5 * offset + np.where((angle > 1.25) | (ajar > 0.1), pull, turn)
    shut = m["gripper_closing"][:, None] > 0.9
    action = towards(np.where(shut, work, offset), np.where(closing, 1.0, -1.0))
    action[:, 3:6] = _lean(m["eef_mat"], out)
    return action


def _over(offset: Array, out: Array) -> Array:
    """8 cm above the handle until it is below; 10 cm before it while too low."""
    aside = np.linalg.norm(offset[:, :2], axis=1, keepdims=True)
    offset = offset + np.where(aside > 0.03, 0.08, 0.0) * UP
    low = (aside > 0.05) & (offset[:, 2:] > 0.035)
    return offset + np.where(low, 0.1, 0.0) * out


def _lean(eef_mat: Array, out: Array) -> Array:
    """Turn the fingers across the handle, the hand leaning 0.3 rad off the door."""
    tool = eef_mat.reshape(-1, 3, 3)
    fingers = np.cos(0.3) * out - np.sin(0.3) * UP
    approach = -np.sin(0.3) * out - np.cos(0.3) * UP
    error = np.cross(tool[:, :, 0], fingers) + np.cross(tool[:, :, 2], approach)
    return np.clip(SPIN / 2 * error, -1, 1)
