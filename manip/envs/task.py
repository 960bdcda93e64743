"""Task: a manipulation task as vectorised functions of named measurements.

A task does not depend on what produced the measurements: the batch engine, a stock
robosuite environment, or anything else with the same names.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np

from manip.arrays import namespace
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.hand_motion import motion_measures
from manip.errors import UserError
from manip.sim.robot_motion import hand_tilt
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors

Array = np.ndarray
Measures = Mapping[str, Array]
"""Named arrays [N, ...] (SI units, world frame): the engine's readings and more."""

Weights = Mapping[str, Mapping[str, float]]
"""Reward set -> term -> weight."""


class Start(NamedTuple):
    """Start states of n episodes: qpos [n, nq], and model fields name -> [n, k]."""

    qpos: Array
    fields: Mapping[str, Array] = {}


class Waypoint(NamedTuple):
    """States in the middle of n episodes: where the objects and the tool are.

    The joint angles of the arm follow from the tool's pose by inverse kinematics.

    Attributes:
        start: the objects' poses and the model fields; the arm's part is the pose from
            which the inverse kinematics search, and to which the controller's null
            space pulls the arm.
        tool_pos: [n, 3] m of the grip site, world frame.
        tool_mat: [n, 9], its rotation matrix row by row.
        closed: whether the gripper has closed around what is between its fingers;
            else it is open.
    """

    start: Start
    tool_pos: Array
    tool_mat: Array
    closed: bool = True


class Task(ABC):
    """A manipulation task, defined once for every backend.

    All methods are vectorised over N environments and must treat each row alone: after
    a reset, they are called with the rows of the environments that restarted.

    Attributes:
        robosuite_name: the robosuite environment that models it.
        sensors: what it reads and sets, by MuJoCo names.
        horizon: length of an episode [control steps].
        weights: reward set -> term -> weight; "shaped" pays in [0, 1] per step, so its
            weights sum to at most 1; "stock" equals robosuite's shaped reward.
        milestone_names: the milestones towards success, in order.
        waypoint_names: the milestones for which `sample_waypoint` generates states.
        proprioception: parts of the observation that a real arm measures by itself;
            all others describe objects.
        hand_reading: the reading [N, 3] m that is the position of the hand.
        takes_tensors: `measure`, `observe`, `reward_terms`, `success`, `failure` and
            `milestones` also compute with torch tensors (see manip.arrays), so that
            MuJoCo Warp can evaluate them on its device.
    """

    robosuite_name: ClassVar[str]
    sensors: ClassVar[Sensors]
    horizon: ClassVar[int]
    weights: ClassVar[Weights]
    milestone_names: ClassVar[tuple[str, ...]]
    waypoint_names: ClassVar[tuple[str, ...]] = ()
    proprioception: ClassVar[tuple[str, ...]] = (
        *("joint_pos", "joint_vel"),
        *("gripper_qpos", "gripper_closing", "eef_pos"),
    )
    hand_reading: ClassVar[str] = "eef_pos"
    takes_tensors: ClassVar[bool] = False

    @abstractmethod
    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the start states of len(streams) episodes."""

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
        """[N] bool: the goal is reached now."""

    @abstractmethod
    def milestones(self, m: Measures) -> dict[str, Array]:
        """Milestone name -> [N] bool: it is reached now."""

    def sample_waypoint(
        self, milestone: str, scene: Scene, streams: EpisodeStreams
    ) -> Waypoint:
        """Draw states of len(streams) episodes in which a milestone has been reached.

        Called for each of `waypoint_names`. Training episodes can start from such
        states (`--waypoint-fraction`); those that the engine cannot hold, or that do
        not reach the milestone, are left out (default: an error).
        """
        raise UserError(
            f"task {self.name!r} has waypoint_names, but no method sample_waypoint"
        )

    def update_memory(self, m: Measures) -> Mapping[str, Array]:
        """Numbers to store for the rest of the episode: sensors.memory name -> [N, k].

        Called as an episode begins and after each step; later readings contain them.
        They must not change the observation (default: nothing is stored).
        """
        return {}

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """Ordered, named numbers [N] that a person can see in a film of the task.

        Preferences are about them (see docs/own-task.md). Besides the
        measures, `m` holds hand_linvel [N, 3] m/s and hand_linacc [N, 3] m/s^2 of the
        last control step. Default: hand_tilt [rad], the angle between the tool's axis
        and straight down; hand_speed [m/s]; hand_acceleration [m/s^2]; closing in
        [0, 1], how far the gripper is commanded to close.
        """
        return {
            "hand_tilt": hand_tilt(m["eef_mat"]),
            **motion_measures(m),
            "closing": (1 + m["gripper_closing"]) / 2,
        }

    def failure(self, m: Measures) -> Array:
        """[N] bool: the episode ends here, without a future (default: never)."""
        joint = m["joint_pos"][:, 0]
        return namespace(joint).zeros_like(joint, dtype=bool)

    def expert(self, m: Measures) -> Array:
        """[N, A] OSC_POSE action in [-1, 1] that solves the task (default: an error).

        An expert proves that the task can be solved, and `--algo bc` imitates it.
        """
        raise UserError(
            f"task {self.name!r} has no expert to imitate: define its method "
            "expert(m), or choose another algorithm"
        )

    @property
    def name(self) -> str:
        """The task's name in commands, files and tables."""
        return type(self).__name__
