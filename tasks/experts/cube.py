"""Taking a cube, whatever is to be done with it."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.cube import clumsy, turn_to_cube
from manip.tasks.experts.motion import towards, upright

Array = np.ndarray

FIRM = 0.12
"""How far a gripper is told to close before it may lift; the slow ones hold by then."""
BRISK = 17
"""Control steps from open to firm: slow hands open no further than that allows."""
COAST = 0.25
"""Gain of the approach: arms that are told to stop move on for 20 control steps."""
FINE = 0.003
"""Correction [m] at full gain; a smaller one does not overcome friction."""


def take_cube(m: Measures, then: Array) -> Array:
    """Above the cube, down to it, close for good; `then` move once it is held.

    Hands turn a cube that lies askew as they close; clumsy ones turn to it before.
    """
    return _squarely(m, then) if clumsy(m) else _askew(m, then)


def _askew(m: Measures, then: Array) -> Array:
    offset = m["to_cube"].copy()
    aside = np.linalg.norm(offset[:, :2], axis=1)
    at_cube = m["distance"] < 0.012
    closing = at_cube | (m["gripper_closing"] > 0.1) | m["grasped"]
    offset[:, 2] += np.where(aside > 0.01, 0.06, 0.0) * ~closing
    offset[m["grasped"]] = then[m["grasped"]]
    return towards(offset, np.where(closing, 1.0, -1.0))


def _squarely(m: Measures, then: Array) -> Array:
    offset, grip, turn = m["to_cube"], m["gripper_closing"], turn_to_cube(m)
    opened = np.maximum(FIRM - BRISK * m["gripper_speed"], -1.0)
    begun = grip > opened + 2 * m["gripper_speed"]
    aside, near = np.linalg.norm(offset[:, :2], axis=1), np.where(begun, 0.02, 0.007)
    apart = ((aside > 0.008) | (np.abs(turn) > 0.1)) & ~(begun & (m["distance"] < near))
    closing = m["grasped"] | (~apart & (m["distance"] < near))
    firm = (m["grasped"] & (grip > FIRM))[:, None]
    offset = np.where(firm, then, _approach(offset, apart & ~closing))
    action = towards(offset, np.where(closing | (grip < opened), 1.0, -1.0))
    action[:, 3:6] = upright(m["eef_mat"], turn * ~closing)
    return action


def _approach(offset: Array, apart: Array) -> Array:
    """To 6 cm above the cube as long as the hand is not over it, without overshoot."""
    ahead = offset[:, :2]
    ahead = COAST * ahead + np.clip((1 - COAST) * ahead, -FINE, FINE)
    return np.column_stack([ahead, 0.7 * (offset[:, 2] + np.where(apart, 0.06, 0.0))])
