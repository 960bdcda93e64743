"""Grasp a cube: the first part of the experts of Lift, Push and PickGoal."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.cube import must_align, yaw_to_cube
from manip.tasks.experts.motion import move_action, upright_turn

Array = np.ndarray

FIRM = 0.12
"""Gripper command from which the hand may lift; slow grippers hold the cube by then."""
CLOSING_STEPS = 17
"""Control steps that a slow gripper may take from open to FIRM. It opens no further."""
MISSED = 0.03
"""Distance [m] of the cube from the tool at which a closed gripper has missed it."""
COAST = 0.25
"""Gain of the approach: the arms of slow grippers coast on for 20 control steps."""
FINE = 0.003
"""Correction [m] at full gain; a smaller one does not overcome friction."""


def take_cube(m: Measures, then: Array) -> Array:
    """Move above the cube, down to it, and close; then move along `then` [n, 3] m.

    Most hands turn a cube to them as they close. Others align with it first.
    """
    return _take_aligned(m, then) if must_align(m) else _take(m, then)


def _take(m: Measures, then: Array) -> Array:
    offset = m["to_cube"].copy()
    aside = np.linalg.norm(offset[:, :2], axis=1)
    at_cube = m["distance"] < 0.012
    shut = m["gripper_closing"] > 0.1
    closing = at_cube | (shut & (m["distance"] < MISSED)) | m["grasped"]
    offset[:, 2] += np.where((aside > 0.01) | shut, 0.06, 0.0) * ~closing
    offset[m["grasped"]] = then[m["grasped"]]
    return move_action(offset, np.where(closing, 1.0, -1.0))


def _take_aligned(m: Measures, then: Array) -> Array:
    offset, grip, turn = m["to_cube"], m["gripper_closing"], yaw_to_cube(m)
    opened = np.maximum(FIRM - CLOSING_STEPS * m["gripper_speed"], -1.0)
    begun = grip > opened + 2 * m["gripper_speed"]
    aside, near = np.linalg.norm(offset[:, :2], axis=1), np.where(begun, 0.02, 0.007)
    apart = ((aside > 0.008) | (np.abs(turn) > 0.1)) & ~(begun & (m["distance"] < near))
    closing = m["grasped"] | (~apart & (m["distance"] < near))
    firm = (m["grasped"] & (grip > FIRM))[:, None]
    offset = np.where(firm, then, _approach(offset, apart & ~closing))
    action = move_action(offset, np.where(closing | (grip < opened), 1.0, -1.0))
    action[:, 3:6] = upright_turn(m["eef_mat"], turn * ~closing)
    return action


def _approach(offset: Array, apart: Array) -> Array:
    """[n, 3] m: to 6 cm above the cube while `apart` [n], without overshoot."""
    ahead = offset[:, :2]
    ahead = COAST * ahead + np.clip((1 - COAST) * ahead, -FINE, FINE)
    return np.column_stack([ahead, 0.7 * (offset[:, 2] + np.where(apart, 0.06, 0.0))])
