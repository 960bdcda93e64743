"""PickPlace: the terms of its rewards.

Shaped reward, in [0, 1] per step: 0.1 reach + 0.15 grasp + 0.15 lift + 0.25 carry
    + 0.05 over + 0.1 release + 0.2 place.
    reach: 1 - tanh(5 d) of the distance d [m] from the tool to the grip on the object,
        times a factor that falls to 0.5 as an empty gripper closes.
    grasp: rises from 0 to 1 as the gripper's command goes from open to closed.
    lift: rises linearly over the first 20 cm of height.
    carry: lift times a ramp over the object's distance from its place, which falls from
        1 to 0 over 75 cm.
    over: 1 once the object is grasped within 7 cm of its place, or released there
        upright, or inside its quarter. Then the terms above but reach are 1 as well.
    release: while the object is grasped there, rises as the command goes from closed to
        open; 1 once it is released. Then reach is 1 as well.
    place: once it is released, rises to 0.5 as the tool moves away; 1 on success.
    The terms grasp, lift and carry need a firm grasp: both finger pads touch the object
    and the tool is inside its box.

A grasped object pays less than 0.8, an upright released one at least 0.8. While a
leaning one paid as much, policies tossed tall boxes, and those that leaned against a
wall of the bin were too high for success.
"""

import numpy as np

from manip.envs.task import Measures, Weights
from manip.rewards.kernels import near, ramp
from manip.tasks.arm import reach_factor
from manip.tasks.pick_place_items import BIN
from manip.tasks.pick_place_measures import over_quarter

Array = np.ndarray

CLEAR = np.arctanh(0.4) / 10
"""Distance [m] of the tool from the object for success
(robosuite/environments/manipulation/pick_place.py)."""
LIFTED = 0.25
"""Height [m] above the bin's origin for robosuite's full lifting reward (ibid.)."""

WEIGHTS: Weights = {
    "shaped": {
        "reach": 0.1,
        "grasp": 0.15,
        "lift": 0.15,
        "carry": 0.25,
        "over": 0.05,
        "release": 0.1,
        "place": 0.2,
    },
    "stock": {"staged": 0.7, "success": 1.0},
}


def shaped_terms(m: Measures, success: Array) -> dict[str, Array]:
    """Terms [N] of the shaped reward; see the module's docstring."""
    grasp, arrived = m["firm_grasp"], m["firm_grasp"] & m["over"]
    released = ~m["grasped"] * np.maximum(m["inside"], m["over"] * _upright(m))
    there = np.maximum(arrived, released)
    lift = grasp * ramp(m["height"], 0.0, 0.2)
    nearer = ramp(-_length(m["to_place"]), -0.75, 0.0)
    opening = ramp(-m["gripper_closing"], -1.0, 1.0)
    reach = reach_factor(m) * near(_length(m["to_grip"]), 0.2)
    away = np.where(success, 1.0, 0.5 * ramp(m["distance"], 0.0, CLEAR))
    return {
        "reach": np.maximum(released, reach),
        "grasp": np.maximum(there, grasp * ramp(m["gripper_closing"], -1.0, 1.0)),
        "lift": np.maximum(there, lift),
        "carry": np.maximum(there, lift * nearer),
        "over": there,
        "release": np.maximum(released, arrived * opening),
        "place": released * away,
    }


def _upright(m: Measures) -> Array:
    """[N] in [0, 1]: 1 for an object that leans by up to 18 degrees, 0 from 40 on."""
    return ramp(m["object_mat"][:, 8], 0.77, 0.95)


def stock_terms(m: Measures, success: Array) -> dict[str, Array]:
    """Terms [N] of robosuite's shaped reward (`PickPlace.staged_rewards`).

    `staged` is the largest of its stages. Its lifting stage uses the highest object.
    """
    lift = m["grasped"] * (0.35 + 0.15 * near(_below_lifted(m), 1 / 15))
    over = over_quarter(m["to_place"])
    hover = np.where(over, 0.5, lift) + 0.2 * near(_length(m["to_place"]), 0.1)
    staged = np.maximum(0.1 * near(m["distance"], 0.1), hover)
    return {
        "staged": ~success * staged / 0.7,
        "success": success.astype(float),
    }


def _below_lifted(m: Measures) -> Array:
    """[N] m: how far the highest of all objects is below robosuite's lifting height."""
    names = [name for name in m if name.startswith("other_") and name.endswith("_pos")]
    top = np.max([m[name][:, 2] for name in ("object_pos", *names)], axis=0)
    return np.maximum(BIN[2] + LIFTED - top, 0.0)


def _length(offset: Array) -> Array:
    return np.linalg.norm(offset, axis=-1)


TERMS = {"shaped": shaped_terms, "stock": stock_terms}
