"""The scripted expert of TwoArmPegInHole."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.motion import GAIN, TURN_GAIN
from manip.tasks.two_arms import joint_action

Array = np.ndarray

DIRECTION = np.array([-(0.5**0.5), 0.0, -(0.5**0.5)])
"""Direction of the peg and of the hole: each hand leans aside by 45 degrees."""
PLACE = np.array([0.0, 0.05, 1.05])
"""Where the hole is held [m]."""
BEFORE, INSIDE = 0.2, 0.06
"""Distances [m] of the hole along the peg's axis: before the insertion, after it."""


def insert_peg(m: Measures) -> Array:
    """Turn peg and hole into one line, bring the peg before the hole, and insert it.

    While they turn, the peg keeps its distance from the plate.
    """
    hole = m["peg_pos"] + m["to_hole"]
    inside = (m["along"] < 0.15) & (m["aside"] < 0.04)
    ready = (m["cos"] > 0.99) & ((m["aside"] < 0.01) | inside)
    depth = np.where(ready, INSIDE, BEFORE)[:, None]
    offset = m["to_hole"] - depth * DIRECTION
    offset[:, 1] *= m["cos"] > 0.95
    turns = [np.cross(m[f"{name}_axis"], DIRECTION) for name in ("peg", "hole")]
    moves = np.where(ready[:, None], np.clip(offset, -0.02, 0.02), offset), PLACE - hole
    return joint_action(*(_action(*each) for each in zip(moves, turns, strict=True)))


def _action(offset: Array, turn: Array) -> Array:
    """[n, 6]: move along `offset` [n, 3] m and turn by `turn` [n, 3] rad."""
    return np.clip(np.hstack([GAIN * offset, TURN_GAIN * turn]), -1, 1)
