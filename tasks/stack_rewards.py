"""Stack: the terms of its rewards.

Shaped reward, in [0, 1] per step: 0.08 reach + 0.08 grasp + 0.08 lift + 0.16 align
    + 0.12 lower + 0.05 on + 0.13 open + 0.15 release + 0.15 clear.
    reach: 1 - tanh(5 d) of the distance d [m] from the tool to A.
    grasp: rises from 0 to 1 as the gripper's command goes from open to closed.
    lift: rises linearly over the first 5 cm of height.
    align: lift times 1 - tanh(6 r) of A's horizontal distance r [m] from B.
    lower: rises linearly over the last 5 cm above B, times 1 - tanh(25 r).
    on: 1 while A rests on B. Then the terms above are 1 as well.
    open: while A rests on B, rises as the command goes from closed to open.
    release: 1 on success.
    clear: on success, rises linearly until the tool is 6 cm away from A.
    The terms from grasp to lower are multiplied by the grasp quality: 0 unless both
    finger pads touch A, 1 for d < 1.5 cm, falling to 0 at d = 2.5 cm.

A above B pays at most 0.52, A grasped on B 0.57. Policies stop at a stage if the next
one pays less, pays little more, or pays only at its end. Without open, they moved one
pad barely off A, and lost the cube again. Without clear, the hand stayed at the cube
and knocked it down.
"""

import numpy as np

from manip.arrays import floats, namespace
from manip.envs.task import Measures, Weights
from manip.rewards.kernels import near, ramp

Array = np.ndarray

HALF = {"cubeA": 0.02, "cubeB": 0.025}
"""Half an edge [m] of each cube (robosuite/environments/manipulation/stack.py)."""
STACKED = HALF["cubeA"] + HALF["cubeB"]
"""Height [m] of A's centre above B's when A lies on B."""
SUCCESS_HEIGHT = 0.04
"""Height [m] of A's centre above the table, for success (ibid.)."""
CLEAR = 0.06
"""Distance [m] of the tool from A's centre at which it does not disturb A."""

WEIGHTS: Weights = {
    "shaped": {
        "reach": 0.08,
        "grasp": 0.08,
        "lift": 0.08,
        "align": 0.16,
        "lower": 0.12,
        "on": 0.05,
        "open": 0.13,
        "release": 0.15,
        "clear": 0.15,
    },
    "stock": {
        "reach": 0.125,
        "grasp": 0.125,
        "lift": 0.5,
        "align": 0.25,
        "stack": 1.0,
    },
}


def shaped_terms(m: Measures, success: Array) -> dict[str, Array]:
    """Terms [N] of the shaped reward; see the module's docstring."""
    on, grasp, xp = m["on"], m["grasp_quality"], namespace(m["on"])
    lift = grasp * ramp(m["height"] - HALF["cubeA"], 0.0, 0.05)
    return {
        "reach": xp.maximum(on, near(m["distance"], 0.2)),
        "grasp": xp.maximum(on, grasp * ramp(m["gripper_closing"], -1.0, 1.0)),
        "lift": xp.maximum(on, lift),
        "align": xp.maximum(on, lift * near(m["aside"], 1 / 6)),
        "lower": xp.maximum(on, grasp * _lowered(m)),
        "on": floats(on),
        "open": on * ramp(-m["gripper_closing"], -1.0, 1.0),
        "release": on * floats(success),
        "clear": on * success * ramp(m["distance"], 0.0, CLEAR),
    }


def _lowered(m: Measures) -> Array:
    """[N] in [0, 1]: how near A is to lying on B, from 5 cm above it."""
    above = m["from_b"][:, 2] - STACKED
    over = near(m["aside"], 0.04) * (above > -0.005)
    return over * ramp(-above, -0.05, 0.0)


def stock_terms(m: Measures, success: Array) -> dict[str, Array]:
    """Terms [N] of robosuite's shaped reward (`Stack.staged_rewards`)."""
    lifted = m["height"] > SUCCESS_HEIGHT
    return {
        "reach": ~lifted * near(m["distance"], 0.1),
        "grasp": ~lifted * m["grasped"],
        "lift": floats(lifted & ~success),
        "align": (lifted & ~success) * near(m["aside"], 1.0),
        "stack": floats(success),
    }


TERMS = {"shaped": shaped_terms, "stock": stock_terms}
