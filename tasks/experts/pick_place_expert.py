"""The scripted expert of the four PickPlace tasks of one object."""

import numpy as np

from manip.envs.task import Measures
from manip.rewards.kernels import ramp
from manip.tasks.experts.motion import UP, move_action, upright_turn
from manip.tasks.rotations import nearest_turn, yaw_angle

Array = np.ndarray


def pick_and_place(m: Measures, bin_centre: Array, symmetry: int) -> Array:
    """Align with the object, grasp it, carry it over its target, lower and release it.

    bin_centre [3] m: of the first bin; symmetry: see `pick_place_items.Item`.
    """
    no_turn = np.zeros(len(m["to_grip"]))
    turn = _turn(m, bin_centre, symmetry) if symmetry else no_turn
    return move_object(m, turn, _across(m), m["height"] < 0.03)


def move_object(
    m: Measures, turn: Array, carry: Array, low: Array, near: Array | bool = True
) -> Array:
    """The action of the hand.

    Args:
        m: measures.
        turn: [n] rad, of the open hand.
        carry: [n, 3] m, offset of a carried object.
        low: [n] bool: a carried object is low enough to be released over its place.
        near: [n] bool: the hand is near the object, so that it has just released it.
    """
    offset, grip = m["to_grip"].copy(), m["gripper_closing"]
    aside = np.linalg.norm(offset[:, :2], axis=1)
    apart = (aside > 0.01 + 0.01 * ramp(offset[:, 2], -0.05, 0.0)) | (abs(turn) > 0.1)
    still = (np.abs(m["joint_vel"]).max(axis=1) < 0.1) & (offset[:, 2] > -0.03)
    at_grip = (np.linalg.norm(offset, axis=1) < 0.012) | (still & ~apart)
    release = m["over"] & ((~m["grasped"] & near) | low | (grip < 0.9))
    closing = (m["grasped"] | at_grip | (~apart & (grip > -0.9))) & ~release
    offset[:, 2] += np.where(apart & ~closing, 0.07, 0.0)
    carried = m["grasped"] & (grip > 0.9)
    offset = np.where(carried[:, None], carry, offset)
    leave = np.where(m["grasped"], 0.0, 0.1)[:, None] * UP
    offset = np.where(release[:, None], leave, offset)
    action = move_action(offset, np.where(closing, 1.0, -1.0))
    action[:, 3:6] = upright_turn(m["eef_mat"], turn * ~closing * ~release)
    return action


def _turn(m: Measures, bin_centre: Array, symmetry: int) -> Array:
    """[n] rad: yaw of the tool that puts the fingers in the wider gap to the walls."""
    gap = [0.2, 0.25] - np.abs(m["object_pos"][:, :2] - bin_centre[:2])
    wide, period = np.pi / 2 * (gap[:, 1] > gap[:, 0]), 2 * np.pi / symmetry
    angle = yaw_angle(m["object_mat"]) + np.pi / 2
    angle += period * np.round((wide - angle) / period)
    return nearest_turn(angle - yaw_angle(m["eef_mat"]), np.pi)


def _across(m: Measures) -> Array:
    """[n, 3] m: 12 cm up before the wall, across, down within 5 cm of the target."""
    there = np.linalg.norm(m["to_place"], axis=1) < 0.05
    clear = there | (m["height"] > 0.09) | (m["object_pos"][:, 1] < -0.12)
    down = np.where(there, 0.0, 0.12) - m["height"]
    return np.column_stack([m["to_place"] * clear[:, None], down])
