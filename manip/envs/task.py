"""What a task is: vectorised functions of named measurements.

A task knows nothing of what produced the measurements: the batch engine, a stock
robosuite environment, or anything else with the same names.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.errors import UserError
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors

Array = np.ndarray
Measures = Mapping[str, Array]
"""Named arrays [N, ...] (SI units, world frame): the engine's readings and more."""

Weights = Mapping[str, Mapping[str, float]]
"""Reward set -> term -> weight."""


class Start(NamedTuple):
    """Where n episodes start: qpos [n, nq], and model fields name -> [n, k]."""

    qpos: Array
    fields: Mapping[str, Array] = {}


class Task(ABC):
    """A manipulation task, stated once for every backend.

    Attributes:
        robosuite_name: the robosuite environment that models it.
        sensors: what it reads and sets, by MuJoCo names.
        horizon: length of an episode [control steps].
        weights: reward set -> term -> weight; "shaped" pays in [0, 1] per step,
            "stock" equals robosuite's shaped reward.
        milestone_names: the milestones towards success, in order.
    """

    robosuite_name: ClassVar[str]
    sensors: ClassVar[Sensors]
    horizon: ClassVar[int]
    weights: ClassVar[Weights]
    milestone_names: ClassVar[tuple[str, ...]]

    @abstractmethod
    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw where len(streams) episodes start."""

    @abstractmethod
    def measure(self, read: Measures) -> Measures:
        """Add the task's own quantities to the readings."""

    @abstractmethod
    def observe(self, m: Measures) -> dict[str, Array]:
        """Ordered, named parts [N, k] of the observation, numbers of order one."""

    @abstractmethod
    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Raw terms [N] of the reward set, under the same names as its weights."""

    @abstractmethod
    def success(self, m: Measures) -> Array:
        """[N] bool: the goal holds now."""

    @abstractmethod
    def milestones(self, m: Measures) -> dict[str, Array]:
        """Stage name -> [N] bool: the milestone holds now."""

    def update_memory(self, m: Measures) -> Mapping[str, Array]:
        """What to keep of the episode: names of sensors.memory -> [N, k].

        Asked as an episode begins and after each step; later readings hold it, which
        must not change what is observed (default: nothing).
        """
        return {}

    def failure(self, m: Measures) -> Array:
        """[N] bool: the episode ends here, without a future (default: never)."""
        return np.zeros(len(m["joint_pos"]), bool)

    def expert(self, m: Measures) -> Array:
        """[N, A] in [-1, 1]: what solves the task, by OSC_POSE (default: nothing does).

        Worth writing: it proves that the task can be solved, and `--algo bc` clones it.
        """
        raise UserError(
            f"task {self.name!r} has no script to imitate: give it a method script(m), "
            "or choose another algorithm"
        )

    @property
    def name(self) -> str:
        """The task's name in commands, files and tables."""
        return type(self).__name__
