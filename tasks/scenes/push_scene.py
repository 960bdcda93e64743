"""The robosuite environment of Push: slide a cube to a goal on the table.

Importing this module registers it: `robosuite.make("Push", robots="Panda")` works.
"""

import numpy as np

from manip.tasks.scenes.cube_scene import HALF, CubeScene
from manip.tasks.scenes.goal_scene import TABLE, reach_reward

Array = np.ndarray

GOAL_LOW = np.array([-0.12, -0.2, TABLE[2]])
GOAL_HIGH = np.array([0.12, 0.2, TABLE[2]])
"""Corners [m] of the rectangle in which goals are drawn."""
MIN_START_DISTANCE = 0.1
"""Smallest distance [m] of the cube's start from the goal."""
SUCCESS_DISTANCE = 0.03
"""Largest horizontal distance [m] of the cube's centre from the goal, for success."""
REST_TOLERANCE = 0.01
"""Height [m] above its rest below which the cube counts as on the table."""


class Push(CubeScene):
    """Slide the cube within 3 cm of the goal, on the table.

    Shaped reward before success: 0.25 (1 - tanh(10 d)) of the distance d [m] from the
    tool to the cube, and 0.5 (1 - tanh(10 r)) of the cube's horizontal distance r [m]
    from the goal.
    """

    goal_low = GOAL_LOW
    goal_high = GOAL_HIGH
    goal_site = {"type": "cylinder", "size": (SUCCESS_DISTANCE, 0.001)}
    min_start_distance = MIN_START_DISTANCE

    def _shaped_reward(self) -> float:
        goal, cube = self._goal_pos(), self._cube_pos()
        slide = reach_reward(goal[:2], cube[:2])
        return 0.25 * reach_reward(self._tool_pos(), cube) + 0.5 * slide

    def _check_success(self) -> bool:
        goal, cube = self._goal_pos(), self._cube_pos()
        gap = np.linalg.norm(goal[:2] - cube[:2])
        on_table = cube[2] - TABLE[2] - HALF < REST_TOLERANCE
        return bool(gap < SUCCESS_DISTANCE and on_table)
