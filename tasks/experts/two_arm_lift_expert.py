"""The scripted expert of TwoArmLift."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.hand_moves import Move, as_action, choose, fetch_bar
from manip.tasks.experts.motion import UP
from manip.tasks.rotations import rotation_matrix
from manip.tasks.two_arms import ROBOTS, joint_action, of_robot

Array = np.ndarray

TARGET = 0.13
"""Height [m] of the pot's bottom above the table, to which it is lifted."""


def lift_pot(m: Measures) -> Array:
    """Take both handles from above; once both are grasped, lift the pot level."""
    robots = [of_robot(m, number) for number in ROBOTS]
    bar = rotation_matrix(m["pot_quat"])[:, ::3]
    moves = [
        fetch_bar(own, own["to_handle"], along=_nearer(own, bar)) for own in robots
    ]
    firm = [own["grasped"] & (own["gripper_closing"] > 0.9) for own in robots]
    lifted = [
        _lift(m, number, move) for number, move in zip(ROBOTS, moves, strict=True)
    ]
    both = firm[0] & firm[1]
    chosen = [choose(both, up, move) for up, move in zip(lifted, moves, strict=True)]
    return joint_action(*map(as_action, chosen))


def _nearer(m: Measures, bar: Array) -> Array:
    """[n, 3]: the direction of a bar for which the fingers have the shorter turn."""
    fingers = np.cross(bar, -UP)
    ahead = (fingers * m["eef_mat"][:, ::3]).sum(axis=1, keepdims=True) >= 0
    return np.where(ahead, bar, -bar)


def _lift(m: Measures, number: int, move: Move) -> Move:
    """Raise a handle, and the lower one faster."""
    height = [m[f"handle{each}_pos"][:, 2] for each in ROBOTS]
    rise = np.clip(TARGET - m["height"], -0.02, 0.03)
    rise += np.mean(height, axis=0) - height[number]
    close = np.ones(len(rise), bool)
    return Move(rise[:, None] * UP, move.turn, close)
