"""Taking a cube, whatever is to be done with it."""

import numpy as np

from manip.envs.task import Measures
from tasks.scripts.motion import towards

Array = np.ndarray


def take_cube(m: Measures, then: Array) -> Array:
    """Above the cube, down to it, close for good; `then` move once both pads touch."""
    offset = m["to_cube"].copy()
    aside = np.linalg.norm(offset[:, :2], axis=1)
    at_cube = m["distance"] < 0.012
    closing = at_cube | (m["gripper_closing"] > 0.1) | m["grasped"]
    offset[:, 2] += np.where(aside > 0.01, 0.06, 0.0) * ~closing
    offset[m["grasped"]] = then[m["grasped"]]
    return towards(offset, np.where(closing, 1.0, -1.0))
