"""The robosuite environment of Reach: bring the tool to a goal above the table.

Importing this module registers it: `robosuite.make("Reach", robots="Panda")` works.
"""

from collections.abc import Callable

import numpy as np

from manip.tasks.scenes.goal_scene import GoalScene, reach_reward

Array = np.ndarray

GOAL_LOW = np.array([-0.15, -0.25, 0.90])
GOAL_HIGH = np.array([0.15, 0.25, 1.20])
"""Corners [m] of the box in which goals are drawn."""
SUCCESS_DISTANCE = 0.02
"""Largest distance [m] of the grip site from the goal, for success."""


class Reach(GoalScene):
    """Bring the grip site within 2 cm of the goal.

    Shaped reward before success: 1 - tanh(10 d) of the distance d [m].
    """

    goal_low = GOAL_LOW
    goal_high = GOAL_HIGH

    def _shaped_reward(self) -> float:
        return reach_reward(self._goal_pos(), self._tool_pos())

    def _object_observables(self) -> dict[str, Callable[[], Array]]:
        return {
            **super()._object_observables(),
            "gripper_to_goal_pos": lambda: self._goal_pos() - self._tool_pos(),
        }

    def _check_success(self) -> bool:
        gap = np.linalg.norm(self._goal_pos() - self._tool_pos())
        return bool(gap < SUCCESS_DISTANCE)
