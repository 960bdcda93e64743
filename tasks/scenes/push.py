"""A robosuite environment that robosuite lacks: slide a cube to a goal on the table.

Importing this module registers it: `robosuite.make("Push", robots="Panda")` works.
"""

import numpy as np

from manip.tasks.scenes.cube import HALF, CubeScene
from manip.tasks.scenes.goal import TABLE, closeness

Array = np.ndarray

GOAL_LOW = np.array([-0.12, -0.2, TABLE[2]])
GOAL_HIGH = np.array([0.12, 0.2, TABLE[2]])
"""Corners of the rectangle [m] in which goals are drawn."""
APART = 0.1
"""Least distance [m] of the cube's start from the goal."""
REACHED = 0.03
"""Success distance [m], horizontal, of the cube's centre from the goal."""
DOWN = 0.01
"""Height [m] above its rest below which the cube counts as on the table."""


class Push(CubeScene):
    """Slide the cube within 3 cm of the goal, on the table.

    Shaped reward before success: 0.25 (1 - tanh(10 d)) of the distance d [m] of the
    tool from the cube, and 0.5 (1 - tanh(10 r)) of the cube's horizontal distance r [m]
    from the goal.
    """

    goal_low = GOAL_LOW
    goal_high = GOAL_HIGH
    goal_mark = {"type": "cylinder", "size": (REACHED, 0.001)}
    apart = APART

    def _partial(self) -> float:
        goal, cube = self._goal(), self._cube()
        there = closeness(goal[:2], cube[:2])
        return 0.25 * closeness(self._tool(), cube) + 0.5 * there

    def _check_success(self) -> bool:
        goal, cube = self._goal(), self._cube()
        gap = np.linalg.norm(goal[:2] - cube[:2])
        return bool(gap < REACHED and cube[2] - TABLE[2] - HALF < DOWN)
