"""The robosuite environment of PickGoal: hold a cube at a goal in the air.

Importing this module registers it: `robosuite.make("PickGoal", robots="Panda")` works.
"""

import numpy as np

from manip.tasks.scenes.cube_scene import CubeScene
from manip.tasks.scenes.goal_scene import reach_reward

Array = np.ndarray

GOAL_LOW = np.array([-0.12, -0.2, 0.90])
GOAL_HIGH = np.array([0.12, 0.2, 1.10])
"""Corners [m] of the box in which goals are drawn."""
SUCCESS_DISTANCE = 0.025
"""Largest distance [m] of the cube's centre from the goal, for success."""


class PickGoal(CubeScene):
    """Bring the cube's centre within 2.5 cm of the goal, 10 to 30 cm above the table.

    Shaped reward before success: 0.25 (1 - tanh(10 d)) of the distance d [m] from the
    tool to the cube; while both finger pads touch the cube another 0.25, and
    0.25 (1 - tanh(10 r)) of the cube's distance r [m] from the goal.
    """

    goal_low = GOAL_LOW
    goal_high = GOAL_HIGH

    def _shaped_reward(self) -> float:
        reach = reach_reward(self._tool_pos(), self._cube_pos())
        carry = reach_reward(self._cube_pos(), self._goal_pos())
        gripper = self.robots[0].gripper["right"]
        grasped = self._check_grasp(gripper=gripper, object_geoms=self.cube)
        return 0.25 * (reach + grasped * (1.0 + carry))

    def _check_success(self) -> bool:
        gap = np.linalg.norm(self._goal_pos() - self._cube_pos())
        return bool(gap < SUCCESS_DISTANCE)
