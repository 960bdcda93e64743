"""Scripted policies: a few lines that solve a task, as proof that it can be solved.

Each maps measures [N, ...] to OSC_POSE actions [N, 7] and remembers nothing.
"""

import numpy as np

from manip.envs.task import Measures

Array = np.ndarray

GAIN = 20.0
"""Action for a metre of distance: full speed from 5 cm on."""


def reach(m: Measures) -> Array:
    """Straight to the goal."""
    return _towards(m["to_goal"], np.ones(len(m["to_goal"])))


def lift(m: Measures) -> Array:
    """Above the cube, down to it, close for good, and up once both pads touch."""
    offset = m["to_cube"].copy()
    aside = np.linalg.norm(offset[:, :2], axis=1)
    at_cube = m["distance"] < 0.012
    closing = at_cube | (m["gripper_closing"] > 0.1) | m["grasped"]
    offset[:, 2] += np.where(aside > 0.01, 0.06, 0.0) * ~closing
    offset[m["grasped"]] = [0.0, 0.0, 0.1]
    return _towards(offset, np.where(closing, 1.0, -1.0))


def _towards(offset: Array, grip: Array) -> Array:
    still = np.zeros((len(offset), 3))
    return np.concatenate([np.clip(GAIN * offset, -1, 1), still, grip[:, None]], axis=1)


SCRIPTS = {"Lift": lift, "Reach": reach}
