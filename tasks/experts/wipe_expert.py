"""The scripted expert of Wipe."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.motion import move_action, upright_turn

Array = np.ndarray


def wipe_table(m: Measures) -> Array:
    """Move 3 cm above the nearest marker, lower the wiper within 3 cm of it, repeat."""
    offset = m["nearest"].copy()
    over = np.linalg.norm(offset[:, :2], axis=1) < 0.03
    offset[:, 2] += np.where(over, -0.004, 0.03)
    zero = np.zeros(len(offset))
    move = move_action(offset, zero)[:, :3]
    return np.hstack([move, upright_turn(m["eef_mat"], zero)])
