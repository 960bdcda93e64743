"""The scripted expert of Stack."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.motion import UP, move_action, upright_turn
from manip.tasks.rotations import nearest_turn, rotation_matrix, yaw_angle

Array = np.ndarray

CROWDED = 0.1
"""Distance [m] of B from A up to which an open finger between them may land on B."""
LIFTED = 0.03
"""Height [m] of A's centre above the table from which A no longer lies on it."""
AIM = 0.013
"""Error [m] of the hand above A, aside and in yaw, up to which it goes down to A."""
YAW_RADIUS = 0.05
"""Weight [m/rad] of the yaw in that error."""
TILT = 0.05
"""Tilt of the hand [rad] that is not corrected: some arms do not reach A upright."""
PLACE = 0.01
"""Distance [m] of A aside of B up to which it goes down to B."""


def stack_cubes(m: Measures, height: float) -> Array:
    """Align with A, close, lift, move over B, lower, and open once A rests on B.

    The further the hand is from its aim, the higher it stays. So a small mistake does
    not cost a new approach.

    height: of A's centre above B's when A lies on B [m].
    """
    grip, turn = m["gripper_closing"], _turn_to_a(m)
    started = (m["distance"] < 0.02) & (grip > -0.9)
    released = m["on"] | _just_above_b(m, height)
    closing = (m["grasped"] | started | (m["distance"] < 0.012)) & ~released
    carried = m["grasped"] & (grip > 0.9)
    offset = np.where(closing[:, None], m["to_a"], _above_a(m["to_a"], turn))
    offset = np.where(carried[:, None], _onto(height * UP - m["from_b"]), offset)
    leave = np.where(grip < -0.5, 0.1, 0.0)[:, None] * UP
    offset = np.where(released[:, None], leave, offset)
    action = move_action(offset, np.where(closing, 1.0, -1.0))
    turn = turn * ~(closing | released)
    action[:, 3:6] = upright_turn(m["eef_mat"], turn, tolerance=TILT)
    return action


def _above_a(to_a: Array, turn: Array) -> Array:
    """[n, 3] m: to A, and up to 6 cm above it while the hand is aside or turned."""
    error = np.linalg.norm(to_a[:, :2], axis=1) + YAW_RADIUS * np.abs(turn)
    return to_a + np.clip(3.0 * (error - AIM), 0.0, 0.06)[:, None] * UP


def _onto(offset: Array) -> Array:
    """[n, 3] m: onto B, and up to 3 cm above it while A is aside.

    A hand that must rise by 2 cm or more does so before it moves aside.
    """
    aside = np.linalg.norm(offset[:, :2], axis=1)
    offset = offset + np.clip(3.0 * (aside - PLACE), -0.005, 0.03)[:, None] * UP
    offset[:, :2] *= (offset[:, 2] < 0.02)[:, None]
    return offset


def _just_above_b(m: Measures, height: float) -> Array:
    """[n] bool: A falls by 3 mm onto B; by up to 1 cm once the gripper opens."""
    fall = np.where(m["gripper_closing"] < 0.7, 0.01, 0.003)
    return (m["from_b"][:, 2] < height + fall) & (m["aside"] < 2 * PLACE)


def _turn_to_a(m: Measures) -> Array:
    """[n] rad: the smallest yaw that aligns the fingers with faces of A.

    While B is near A, with those faces of A between which no finger lands on B.
    """
    hand, cube = yaw_angle(m["eef_mat"]), yaw_angle(rotation_matrix(m["a_quat"]))
    past_b = np.arctan2(m["from_b"][:, 1], m["from_b"][:, 0]) + np.pi / 2
    aligned = past_b + nearest_turn(cube - past_b, np.pi / 2)
    crowded = (m["aside"] < CROWDED) & (m["height"] < LIFTED)
    turn = nearest_turn(cube - hand, np.pi / 2)
    return np.where(crowded, nearest_turn(aligned - hand, np.pi), turn)
