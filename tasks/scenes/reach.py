"""A robosuite environment that robosuite lacks: reach a goal point above the table.

Importing this module registers it: `robosuite.make("Reach", robots="Panda")` works.
"""

from collections.abc import Callable

import numpy as np

from manip.tasks.scenes.goal import GoalScene, closeness

Array = np.ndarray

GOAL_LOW = np.array([-0.15, -0.25, 0.90])
GOAL_HIGH = np.array([0.15, 0.25, 1.20])
"""Corners of the box [m] in which goals are drawn."""
REACHED = 0.02
"""Success distance [m] of the grip site from the goal."""


class Reach(GoalScene):
    """Bring the grip site within 2 cm of the goal.

    Shaped reward before success: 1 - tanh(10 d) of the distance d [m].
    """

    goal_low = GOAL_LOW
    goal_high = GOAL_HIGH

    def _partial(self) -> float:
        return closeness(self._goal(), self._tool())

    def _looks(self) -> dict[str, Callable[[], Array]]:
        return {
            **super()._looks(),
            "gripper_to_goal_pos": lambda: self._goal() - self._tool(),
        }

    def _check_success(self) -> bool:
        return bool(np.linalg.norm(self._goal() - self._tool()) < REACHED)
