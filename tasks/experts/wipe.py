"""How Wipe is solved."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.motion import towards, upright

Array = np.ndarray


def wipe(m: Measures) -> Array:
    """Above the nearest dirt, down on it once 3 cm aside, and on to the next."""
    offset = m["nearest"].copy()
    over = np.linalg.norm(offset[:, :2], axis=1) < 0.03
    offset[:, 2] += np.where(over, -0.004, 0.03)
    still = np.zeros(len(offset))
    move = towards(offset, still)[:, :3]
    return np.hstack([move, upright(m["eef_mat"], still)])
