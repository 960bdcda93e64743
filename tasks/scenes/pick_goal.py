"""A robosuite environment that robosuite lacks: hold a cube at a goal in the air.

Importing this module registers it: `robosuite.make("PickGoal", robots="Panda")` works.
"""

import numpy as np

from manip.tasks.scenes.cube import CubeScene
from manip.tasks.scenes.goal import closeness

Array = np.ndarray

GOAL_LOW = np.array([-0.12, -0.2, 0.90])
GOAL_HIGH = np.array([0.12, 0.2, 1.10])
"""Corners of the box [m] in which goals are drawn."""
REACHED = 0.025
"""Success distance [m] of the cube's centre from the goal."""


class PickGoal(CubeScene):
    """Bring the cube's centre within 2.5 cm of the goal, 10 to 30 cm above the table.

    Shaped reward before success: 0.25 (1 - tanh(10 d)) of the distance d [m] of the
    tool from the cube; while both finger pads touch the cube another 0.25, and
    0.25 (1 - tanh(10 r)) of the cube's distance r [m] from the goal.
    """

    goal_low = GOAL_LOW
    goal_high = GOAL_HIGH

    def _partial(self) -> float:
        reach = closeness(self._tool(), self._cube())
        hand = self.robots[0].gripper["right"]
        grasped = self._check_grasp(gripper=hand, object_geoms=self.cube)
        return 0.25 * (reach + grasped * (1.0 + closeness(self._cube(), self._goal())))

    def _check_success(self) -> bool:
        return bool(np.linalg.norm(self._goal() - self._cube()) < REACHED)
