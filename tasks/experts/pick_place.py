"""How the four PickPlace tasks are solved."""

import numpy as np

from manip.envs.task import Measures
from manip.rewards.kernels import ramp
from manip.tasks.experts.motion import UP, towards, upright
from manip.tasks.objects import yaw

Array = np.ndarray


def pick_place(m: Measures, bin: Array, folds: int) -> Array:
    """Take the object as it is turned, carry it over its place, down, and let go.

    bin [3] m: middle of the first bin; folds: turns that leave the grip as it is.
    """
    offset, grip = m["to_grip"].copy(), m["gripper_closing"]
    turn = _clear_of_walls(m, bin, folds) if folds else np.zeros(len(grip))
    aside = np.linalg.norm(offset[:, :2], axis=1)
    apart = (aside > 0.01 + 0.01 * ramp(offset[:, 2], -0.05, 0.0)) | (abs(turn) > 0.1)
    still = (np.abs(m["joint_vel"]).max(axis=1) < 0.1) & (offset[:, 2] > -0.03)
    at_grip = (np.linalg.norm(offset, axis=1) < 0.012) | (still & ~apart)
    letting = m["over"] & (~m["grasped"] | (m["height"] < 0.03) | (grip < 0.9))
    closing = (m["grasped"] | at_grip | (~apart & (grip > -0.9))) & ~letting
    offset[:, 2] += np.where(apart & ~closing, 0.07, 0.0)
    carried = m["grasped"] & (grip > 0.9)
    offset = np.where(carried[:, None], _across(m), offset)
    leave = np.where(m["grasped"], 0.0, 0.1)[:, None] * UP
    offset = np.where(letting[:, None], leave, offset)
    action = towards(offset, np.where(closing, 1.0, -1.0))
    action[:, 3:6] = upright(m["eef_mat"], turn * ~closing * ~letting)
    return action


def _clear_of_walls(m: Measures, bin: Array, folds: int) -> Array:
    """Turn [rad] of the tool that lays the fingers along the wider gap to the walls."""
    gap = [0.2, 0.25] - np.abs(m["object_pos"][:, :2] - bin[:2])
    wide, period = np.pi / 2 * (gap[:, 1] > gap[:, 0]), 2 * np.pi / folds
    angle = yaw(m["turned"]) + np.pi / 2
    angle += period * np.round((wide - angle) / period)
    turn = angle - yaw(m["eef_mat"])
    return turn - np.pi * np.round(turn / np.pi)


def _across(m: Measures) -> Array:
    """12 cm up before the wall, across, and down less than 5 cm from its place."""
    there = np.linalg.norm(m["to_place"], axis=1) < 0.05
    clear = there | (m["height"] > 0.09) | (m["object_pos"][:, 1] < -0.12)
    down = np.where(there, 0.0, 0.12) - m["height"]
    return np.column_stack([m["to_place"] * clear[:, None], down])
