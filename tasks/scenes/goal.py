"""What robosuite environments of our own share: a table, an arm, and a goal."""

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
    """Something has to be brought to a goal, which is drawn uniformly in a box.

    Reward: 1 on success, else a part of it with reward shaping and 0 without, times
    reward_scale. Options are those of robosuite's Lift, passed by keyword.

    Attributes:
        goal_low, goal_high: corners [3] m of the box.
        goal_mark: size and other attributes of the site that marks the goal.
    """

    goal_low: ClassVar[Array]
    goal_high: ClassVar[Array]
    goal_mark: ClassVar[dict[str, Any]] = {"size": (0.02,)}

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
        return self.reward_scale * self._partial() if self.reward_shaping else 0.0

    @abstractmethod
    def _partial(self) -> float:
        """Shaped reward before success, in [0, 1]."""

    def _looks(self) -> dict[str, Callable[[], Array]]:
        """Observation of the objects -> what it shows."""
        return {"goal_pos": self._goal}

    def _objects(self) -> list[Any]:
        """Build the loose objects."""
        return []

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
        middle = (self.goal_low + self.goal_high) / 2
        green = (0.1, 0.8, 0.2, 0.9)
        arena.worldbody.append(
            new_site("goal", pos=middle, rgba=green, **self.goal_mark)
        )
        self.model = ManipulationTask(arena, [robot], self._objects())

    def _setup_references(self) -> None:
        super()._setup_references()
        self.goal_id = self.sim.model.site_name2id("goal")

    def _setup_observables(self) -> OrderedDict[str, Observable]:
        observables = super()._setup_observables()
        for name, look in self._looks().items():
            observables[name] = Observable(
                name,
                sensor(modality="object")(lambda _, look=look: look()),
                sampling_rate=self.control_freq,
            )
        return observables

    def _reset_internal(self) -> None:
        super()._reset_internal()
        if not self.deterministic_reset:
            goal = self.rng.uniform(self.goal_low, self.goal_high)
            self.sim.model.site_pos[self.goal_id] = goal


def closeness(one: Array, other: Array) -> float:
    """1 - tanh(10 d) of the distance d [m], robosuite's term of reaching."""
    return float(1.0 - np.tanh(10.0 * np.linalg.norm(one - other)))


del REGISTERED_ENVS[GoalScene.__name__]  # no environment by itself
