"""The robosuite environment that Reach, Push and PickGoal derive from."""

from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from robosuite.environments.base import REGISTERED_ENVS
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


class GoalScene(ManipulationEnv):
    """A table, an arm, and a goal that is drawn uniformly in a box.

    Reward: 1 on success. Before success, a part of 1 with reward shaping, 0 without. It
    is multiplied by reward_scale. Options are those of robosuite's Lift, by keyword.

    Attributes:
        goal_low, goal_high: corners [3] m of the box.
        goal_site: size and other attributes of the site that marks the goal.
    """

    goal_low: ClassVar[Array]
    goal_high: ClassVar[Array]
    goal_site: ClassVar[dict[str, Any]] = {"size": (0.02,)}

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
        shaped = self._shaped_reward() if self.reward_shaping else 0.0
        return self.reward_scale * shaped

    @abstractmethod
    def _shaped_reward(self) -> float:
        """Reward before success, in [0, 1]."""

    def _object_observables(self) -> dict[str, Callable[[], Array]]:
        """Name -> function that reads the observation."""
        return {"goal_pos": self._goal_pos}

    def _objects(self) -> list[Any]:
        """Build the loose objects."""
        return []

    def _goal_pos(self) -> Array:
        return np.array(self.sim.data.site_xpos[self.goal_id])

    def _tool_pos(self) -> Array:
        return np.array(self.sim.data.site_xpos[self.robots[0].eef_site_id["right"]])

    def _load_model(self) -> None:
        super()._load_model()
        robot = self.robots[0].robot_model
        robot.set_base_xpos(robot.base_xpos_offset["table"](TABLE_SIZE[0]))
        arena = TableArena(table_full_size=TABLE_SIZE, table_offset=TABLE)
        arena.set_origin([0, 0, 0])
        middle = (self.goal_low + self.goal_high) / 2
        green = (0.1, 0.8, 0.2, 0.9)
        arena.worldbody.append(
            new_site("goal", pos=middle, rgba=green, **self.goal_site)
        )
        self.model = ManipulationTask(arena, [robot], self._objects())

    def _setup_references(self) -> None:
        super()._setup_references()
        self.goal_id = self.sim.model.site_name2id("goal")

    def _setup_observables(self) -> OrderedDict[str, Observable]:
        observables = super()._setup_observables()
        for name, read in self._object_observables().items():
            observables[name] = Observable(
                name,
                sensor(modality="object")(lambda _, read=read: read()),
                sampling_rate=self.control_freq,
            )
        return observables

    def _reset_internal(self) -> None:
        super()._reset_internal()
        if not self.deterministic_reset:
            goal = self.rng.uniform(self.goal_low, self.goal_high)
            self.sim.model.site_pos[self.goal_id] = goal


def reach_reward(one: Array, other: Array) -> float:
    """1 - tanh(10 d) of the distance d [m], as robosuite rewards reaching."""
    return float(1.0 - np.tanh(10.0 * np.linalg.norm(one - other)))


# robosuite registers every subclass. This one cannot be built alone.
del REGISTERED_ENVS[GoalScene.__name__]
