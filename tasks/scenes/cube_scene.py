"""The robosuite environment that Push and PickGoal derive from: a cube and a goal."""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from robosuite.environments.base import REGISTERED_ENVS
from robosuite.models.objects import BoxObject
from robosuite.utils.transform_utils import convert_quat

from manip.tasks.scenes.goal_scene import TABLE, GoalScene

Array = np.ndarray

HALF = 0.02
"""Half an edge [m] of the cube."""
SPREAD = np.array([0.1, 0.15])
"""Half width [m], in x and y, of the rectangle in which the cube starts."""


class CubeScene(GoalScene):
    """The cube starts on the table, at a random position and yaw.

    Attributes:
        min_start_distance: smallest horizontal distance [m] of the start from the goal.
    """

    min_start_distance: ClassVar[float] = 0.0

    def _cube_pos(self) -> Array:
        return np.array(self.sim.data.body_xpos[self.cube_id])

    def _cube_quat(self) -> Array:
        return convert_quat(np.array(self.sim.data.body_xquat[self.cube_id]), "xyzw")

    def _object_observables(self) -> dict[str, Callable[[], Array]]:
        return {
            **super()._object_observables(),
            "cube_pos": self._cube_pos,
            "cube_quat": self._cube_quat,
            "gripper_to_cube_pos": lambda: self._cube_pos() - self._tool_pos(),
            "cube_to_goal_pos": lambda: self._goal_pos() - self._cube_pos(),
        }

    def _objects(self) -> list[Any]:
        self.cube = BoxObject("cube", size=[HALF] * 3, rgba=(0.8, 0.1, 0.1, 1))
        return [self.cube]

    def _setup_references(self) -> None:
        super()._setup_references()
        self.cube_id = self.sim.model.body_name2id(self.cube.root_body)

    def _reset_internal(self) -> None:
        super()._reset_internal()
        if not self.deterministic_reset:
            spot, yaw = self._start_spot(), self.rng.uniform(0, 2 * np.pi)
            turn = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
            pose = [*spot, TABLE[2] + HALF, *turn]
            self.sim.data.set_joint_qpos(self.cube.joints[0], pose)

    def _start_spot(self) -> Array:
        """Draw a start [2] m that is far enough from the goal."""
        goal = self.sim.model.site_pos[self.goal_id][:2]
        while True:
            spot = self.rng.uniform(-SPREAD, SPREAD)
            if np.linalg.norm(spot - goal) > self.min_start_distance:
                return spot


# robosuite registers every subclass. This one cannot be built alone.
del REGISTERED_ENVS[CubeScene.__name__]
