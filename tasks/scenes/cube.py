"""What our environments with a cube share: the cube, and where it starts."""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from robosuite.environments.base import REGISTERED_ENVS
from robosuite.models.objects import BoxObject
from robosuite.utils.transform_utils import convert_quat

from manip.tasks.scenes.goal import TABLE, GoalScene

Array = np.ndarray

HALF = 0.02
"""Half an edge [m] of the cube."""
SPREAD = np.array([0.1, 0.15])
"""Half width [m], in x and y, of the rectangle in which the cube starts."""


class CubeScene(GoalScene):
    """The cube starts on the table, with any yaw.

    Attributes:
        apart: least horizontal distance [m] from the goal at which it starts.
    """

    apart: ClassVar[float] = 0.0

    def _cube(self) -> Array:
        return np.array(self.sim.data.body_xpos[self.cube_id])

    def _turn(self) -> Array:
        return convert_quat(np.array(self.sim.data.body_xquat[self.cube_id]), "xyzw")

    def _looks(self) -> dict[str, Callable[[], Array]]:
        return {
            **super()._looks(),
            "cube_pos": self._cube,
            "cube_quat": self._turn,
            "gripper_to_cube_pos": lambda: self._cube() - self._tool(),
            "cube_to_goal_pos": lambda: self._goal() - self._cube(),
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
            spot, yaw = self._free_spot(), self.rng.uniform(0, 2 * np.pi)
            turn = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
            pose = [*spot, TABLE[2] + HALF, *turn]
            self.sim.data.set_joint_qpos(self.cube.joints[0], pose)

    def _free_spot(self) -> Array:
        goal = self.sim.model.site_pos[self.goal_id][:2]
        while True:
            spot = self.rng.uniform(-SPREAD, SPREAD)
            if np.linalg.norm(spot - goal) > self.apart:
                return spot


del REGISTERED_ENVS[CubeScene.__name__]  # no environment by itself
