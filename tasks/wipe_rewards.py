"""Wipe: the terms of its rewards.

Shaped reward, in [0, 1] per step: 0.15 near + 0.15 touch + 0.5 wiped + 0.2 clean.
    near: 1 - tanh(5 d) of the distance d [m] from the wiper to the nearest marker that
        is not wiped.
    touch: 1 while the wiper touches anything with up to 20 N, falling to 0 at 60 N.
        Without the fall, policies pressed with 70 N and more, and stuck to the table.
    wiped: the fraction of markers that are wiped.
    clean: 1 on success. Then near and touch are 1 as well.
"""

import numpy as np

from manip.envs.task import Measures, Weights
from manip.rewards.kernels import near, ramp

Array = np.ndarray

MAX_FORCE = 60.0
"""Force [N] above which robosuite pays a penalty
(robosuite/environments/manipulation/wipe.py)."""
SOFT_FORCE = 20.0
"""Force [N] up to which the shaped reward pays for a touch in full."""
SCALE = 1000 / (100 * 50 + 1000 * (0.01 + 25.5))
"""robosuite's factor that normalises the reward, with its horizon of 1000 (ibid.)."""

WEIGHTS: Weights = {
    "shaped": {"near": 0.15, "touch": 0.15, "wiped": 0.5, "clean": 0.2},
    "stock": {
        "unsafe": -10 * SCALE,
        "wiped": 50 * SCALE,
        "near": 5 * SCALE,
        "touch": 0.01 * SCALE,
        "press": 0.01 * SCALE,
        "force": -0.05 * SCALE,
        "clean": 50 * 0.51 * SCALE,
    },
}


def shaped_terms(m: Measures, success: Array) -> dict[str, Array]:
    """Terms [N] of the shaped reward; see the module's docstring."""
    force = np.linalg.norm(m["force"], axis=1)
    touch = (m["contacts"] > 0) * (1.0 - ramp(force, SOFT_FORCE, MAX_FORCE))
    return {
        "near": np.maximum(success, near(m["distance"], 0.2)),
        "touch": np.maximum(success, touch),
        "wiped": m["share"],
        "clean": success.astype(float),
    }


def stock_terms(m: Measures, success: Array) -> dict[str, Array]:
    """Terms [N] of robosuite's shaped reward (`Wipe.reward`).

    An unsafe state pays its penalty alone. Forces are those of the previous step.
    """
    safe = ~m["unsafe"]
    force = np.linalg.norm(m["last_force"], axis=1)
    change = np.linalg.norm(m["force"] - m["bias"], axis=1)
    hard = force > MAX_FORCE
    presses = ~hard & (force > 0.5) & (m["contacts"] > 1)
    press = 1 + force + 10 * (m["contacts"] > 50)
    gap = np.linalg.norm(m["centroid"], axis=1)
    return {
        "unsafe": m["unsafe"].astype(float),
        "wiped": safe * m["fresh"],
        "near": safe * ~success * near(gap, 0.2),
        "touch": safe * (m["contacts"] > 0) * (change > 1.0),
        "press": safe * presses * press,
        "force": safe * hard * force,
        "clean": (safe & success).astype(float),
    }


TERMS = {"shaped": shaped_terms, "stock": stock_terms}
