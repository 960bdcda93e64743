"""NutAssembly: the terms of its rewards.

Shaped reward, in [0, 1] per step: 0.1 reach + 0.05 turn + 0.15 grasp + 0.15 lift
    + 0.2 over + 0.05 thread + 0.2 down + 0.05 release + 0.05 stay.
    reach: 1 - tanh(5 d) of the distance d [m] by which the tool is farther than 1.5 cm
        from the handle, times a factor that falls to 0.5 as an empty gripper closes.
    turn: rises as the fingers turn across the handle, within about 10 cm of it.
    grasp: rises as the gripper's command goes from open to closed, times turn's angle
        factor.
    lift: half is paid over the first 4 cm of height, half over the way up to 2 cm above
        the peg.
    over: lift times the nearness of the nut to the peg. 0.6 of it falls linearly over
        50 cm; 0.4 of it falls within 3 cm, times how well a square nut is turned.
    thread: 1 while the peg is in the nut. Then all terms above are 1.
    down: rises as the nut sinks along the peg, once it fits over it.
    release: on the peg, down times how far the command has gone from closed to open.
    stay: 1 on success. Then down and release are 1 as well.
    The terms grasp, lift, over and down need a firm grasp: both finger pads touch the
    nut and the tool is within 2 cm of the handle.

A nut above its peg pays at most 0.69, on the peg at least 0.74, and 1 on success.
When release paid at any height, policies let go of the nut once the peg was in it: of
64 nuts, 57 were on the peg, and 15 of these stayed high on it.
"""

import numpy as np

from manip.envs.task import Measures, Weights
from manip.rewards.kernels import near, ramp
from manip.tasks.arm import reach_factor
from manip.tasks.nut_assembly_measures import REST, SUCCESS_HEIGHT, TABLE, TOP

Array = np.ndarray

FIRST_LIFT = REST + 0.04
"""Height [m] up to which lifting pays the most."""
ABOVE_PEG = TOP + 0.02
"""Height [m] from which a nut's lower side clears the peg by 1 cm."""
LIFTED = TABLE - 0.025 + 0.2
"""Height [m] of the nut's centre for robosuite's full lifting reward
(robosuite/environments/manipulation/nut_assembly.py)."""
REACH_DISTANCE = 0.015
"""Distance [m] of the tool from the handle below which reach pays no more."""

WEIGHTS: Weights = {
    "shaped": {
        "reach": 0.1,
        "turn": 0.05,
        "grasp": 0.15,
        "lift": 0.15,
        "over": 0.2,
        "thread": 0.05,
        "down": 0.2,
        "release": 0.05,
        "stay": 0.05,
    },
    "stock": {"staged": 0.7, "success": 1.0},
}


def shaped_terms(m: Measures, success: Array) -> dict[str, Array]:
    """Terms [N] of the shaped reward; see the module's docstring."""
    on_peg, grasp = m["threaded"] | success, m["firm_grasp"]
    lift = grasp * np.maximum(_lifted(m), m["fits"])
    across = (1 + np.cos(2 * m["handle_turn"])) / 2
    opening = ramp(-m["gripper_closing"], -1.0, 1.0)
    gap = np.maximum(m["distance"] - REACH_DISTANCE, 0.0)
    down = (on_peg | (grasp & m["fits"])) * _lowered(m)
    return {
        "reach": np.maximum(on_peg, reach_factor(m) * near(gap, 0.2)),
        "turn": np.maximum(on_peg, across * near(m["distance"], 0.1)),
        "grasp": np.maximum(on_peg, grasp * across * (1 - opening)),
        "lift": np.maximum(on_peg, lift),
        "over": np.maximum(on_peg, lift * _near_peg(m)),
        "thread": on_peg.astype(float),
        "down": np.maximum(success, down),
        "release": np.maximum(success, on_peg * _lowered(m) * opening),
        "stay": success.astype(float),
    }


def _lifted(m: Measures) -> Array:
    """[N] in [0, 1]: half over the first 4 cm, half over the way above the peg."""
    first, whole = (ramp(m["height"], REST, top) for top in (FIRST_LIFT, ABOVE_PEG))
    return (first + whole) / 2


def _near_peg(m: Measures) -> Array:
    """[N] in [0, 1]: nearness of the nut to the axis of its peg, coarse and fine."""
    coarse = 0.6 * (1 - ramp(m["aside"], 0.0, 0.5))
    return coarse + 0.4 * near(m["aside"], 0.03) * m["fit"]


def _lowered(m: Measures) -> Array:
    """[N] in [0, 1]: how far the nut is down from above the peg."""
    return ramp(-m["height"], -ABOVE_PEG, -SUCCESS_HEIGHT)


def stock_terms(m: Measures, success: Array) -> dict[str, Array]:
    """Terms [N] of robosuite's shaped reward (`NutAssembly.staged_rewards`).

    `staged` is the largest of its stages. Its lifting stage uses the higher nut.
    """
    highest = np.maximum(m["height"], m["other_pos"][:, 2])
    below = np.maximum(LIFTED - highest, 0.0)
    lift = m["grasped"] * (0.35 + 0.15 * near(below, 1 / 15))
    over = lift + 0.2 * near(m["aside"], 0.1)
    staged = np.maximum(0.1 * near(m["distance"], 0.1), over)
    return {
        "staged": ~success * staged / 0.7,
        "success": success.astype(float),
    }


TERMS = {"shaped": shaped_terms, "stock": stock_terms}
