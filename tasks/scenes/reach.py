"""A robosuite environment that robosuite lacks: reach a goal point above the table.

Importing this module registers it: `robosuite.make("Reach", robots="Panda")` works.
"""

from collections import OrderedDict
from typing import Any

import numpy as np
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import TableArena
from robosuite.models.tasks import ManipulationTask
from robosuite.utils.mjcf_utils import new_site
from robosuite.utils.observables import Observable, sensor

Array = np.ndarray

TABLE = np.array([0.0, 0.0, 0.8])
"""Centre of the table top [m], as in robosuite's Lift."""
TABLE_SIZE = (0.8, 0.8, 0.05)
"""Full size of the table top [m], as in robosuite's Lift."""
GOAL_LOW = np.array([-0.15, -0.25, 0.90])
GOAL_HIGH = np.array([0.15, 0.25, 1.20])
"""Corners of the box [m] in which goals are drawn."""
REACHED = 0.02
"""Success distance [m] of the grip site from the goal."""


class Reach(ManipulationEnv):
    """Bring the grip site within 2 cm of a goal drawn uniformly in a box.

    Reward: 1 on success, else 1 - tanh(10 d) with reward shaping and 0 without, times
    reward_scale. Options are those of robosuite's Lift, passed by keyword.
    """

    def __init__(
        self,
        robots: str | list[str],
        initialization_noise: Any = "default",
        reward_scale: float = 1.0,
        reward_shaping: bool = False,
        **options: Any,
    ) -> None:
        self.reward_scale = reward_scale
        self.reward_shaping = reward_shaping
        super().__init__(
            robots=robots, initialization_noise=initialization_noise, **options
        )

    def reward(self, action: Array | None = None) -> float:
        """Reward of the current state; `action` is not used."""
        if self._check_success():
            return self.reward_scale
        shaped = 1.0 - np.tanh(10.0 * self._distance())
        return self.reward_scale * shaped if self.reward_shaping else 0.0

    def _distance(self) -> float:
        return float(np.linalg.norm(self._goal() - self._tool()))

    def _goal(self) -> Array:
        return np.array(self.sim.data.site_xpos[self.goal_id])

    def _tool(self) -> Array:
        return np.array(self.sim.data.site_xpos[self.robots[0].eef_site_id["right"]])

    def _load_model(self) -> None:
        super()._load_model()
        robot = self.robots[0].robot_model
        robot.set_base_xpos(robot.base_xpos_offset["table"](TABLE_SIZE[0]))
        arena = TableArena(table_full_size=TABLE_SIZE, table_offset=TABLE)
        arena.set_origin([0, 0, 0])
        middle = (GOAL_LOW + GOAL_HIGH) / 2
        arena.worldbody.append(
            new_site("goal", pos=middle, size=(0.02,), rgba=(0.1, 0.8, 0.2, 0.9))
        )
        self.model = ManipulationTask(mujoco_arena=arena, mujoco_robots=[robot])

    def _setup_references(self) -> None:
        super()._setup_references()
        self.goal_id = self.sim.model.site_name2id("goal")

    def _setup_observables(self) -> OrderedDict[str, Observable]:
        observables = super()._setup_observables()

        @sensor(modality="object")
        def goal_pos(obs_cache: dict[str, Array]) -> Array:
            return self._goal()

        @sensor(modality="object")
        def gripper_to_goal_pos(obs_cache: dict[str, Array]) -> Array:
            return self._goal() - self._tool()

        for part in (goal_pos, gripper_to_goal_pos):
            observables[part.__name__] = Observable(
                part.__name__, part, sampling_rate=self.control_freq
            )
        return observables

    def _reset_internal(self) -> None:
        super()._reset_internal()
        if not self.deterministic_reset:
            goal = self.rng.uniform(GOAL_LOW, GOAL_HIGH)
            self.sim.model.site_pos[self.goal_id] = goal

    def _check_success(self) -> bool:
        return self._distance() < REACHED
