"""Tasks of other libraries: any robosuite environment, any dm_control.manipulation.

They are named `library/name`. Observation, reward and success are the library's own
(see `manip.sim.external`), and so is the speed.
"""

import importlib
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from manip.envs.hand_motion import motion_measures
from manip.envs.task import Measures, Start, Task
from manip.errors import UserError, check_choice, shown, unknown
from manip.sim.sensors import Sensors

Array = np.ndarray

EARNED = ("reward", "success", "terminated")
"""Readings of an external simulation besides its observation."""


class ExternalTask(Task):
    """A task whose measures are its library's observation, reward and success.

    Raises:
        UserError: the library has no task of this name.
    """

    library: ClassVar[str]

    robosuite_name = ""
    sensors = Sensors()
    weights = {"stock": {"reward": 1.0}}
    milestone_names = ("success",)

    def __init__(self, environment: str) -> None:
        names = self.module().names()
        check_choice(f"{self.library} task", environment, names)
        self.environment = environment

    @classmethod
    def module(cls) -> ModuleType:
        """The module that steps it; importing it loads the library."""
        return importlib.import_module(f"manip.sim.external.{cls.library}_sim")

    @property
    def name(self) -> str:
        """`library/name`."""
        return f"{self.library}/{self.environment}"

    @property
    def notice(self) -> str:
        """What a user should expect."""
        return (
            f"{self.name} is stepped by {self.library} itself, tens of times slower "
            "than the batch engine"
        )

    def sample_start(self, scene: Any, streams: Any) -> Start:
        """Not possible: the library draws its own start states."""
        raise UserError(self.notice)

    def measure(self, read: Measures) -> Measures:
        """The readings themselves."""
        return read

    def observe(self, m: Measures) -> dict[str, Array]:
        """All readings but reward, success and termination."""
        return {name: part for name, part in m.items() if name not in EARNED}

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """The library's reward."""
        return {"reward": m["reward"]}

    def success(self, m: Measures) -> Array:
        """The library's success test."""
        return m["success"]

    def milestones(self, m: Measures) -> dict[str, Array]:
        """Success alone."""
        return {"success": m["success"]}

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """hand_speed [N] m/s and hand_acceleration [N] m/s^2, of the first arm."""
        return motion_measures(m) if self.hand_reading in m else {}

    def failure(self, m: Measures) -> Array:
        """Where the library ends an episode before its time limit."""
        return m["terminated"]


class DmControlTask(ExternalTask):
    """A task of dm_control.manipulation, 10 s long (its _TIME_LIMIT) at 25 Hz."""

    library = "dm_control"
    horizon = 250
    hand_reading = "jaco_arm/jaco_hand/pinch_site_pos"
    proprioception = tuple(
        f"jaco_arm/{name}"
        for name in (
            *("joints_pos", "joints_vel", "joints_torque"),
            *("jaco_hand/joints_pos", "jaco_hand/joints_vel"),
            *("jaco_hand/pinch_site_pos", "jaco_hand/pinch_site_rmat"),
        )
    )


class RobosuiteTask(ExternalTask):
    """A robosuite environment, as long as in robosuite's own benchmark
    (github.com/ARISE-Initiative/robosuite-benchmark).
    """

    library = "robosuite"
    horizon = 500
    hand_reading = "robot0_eef_pos"
    proprioception = tuple(
        f"robot{arm}_{name}"
        for arm in (0, 1)
        for name in (
            *("joint_pos", "joint_pos_cos", "joint_pos_sin", "joint_vel"),
            *("eef_pos", "eef_quat", "eef_quat_site"),
            *("gripper_qpos", "gripper_qvel"),
        )
    )


LIBRARIES: dict[str, type[ExternalTask]] = {
    cls.library: cls for cls in (DmControlTask, RobosuiteTask)
}


def external_names() -> list[str]:
    """`library/name` of every task that other libraries offer."""
    return [
        f"{library}/{name}"
        for library, cls in LIBRARIES.items()
        for name in cls.module().names()
    ]


def simulator_of(env: str, task: str) -> str:
    """What steps a task on a backend, in words: "stock robosuite", "batch engine"."""
    if env == "native":
        return "batch engine"
    if env == "warp":
        return "MuJoCo Warp"
    return f"{env} {task.split('/')[0] if '/' in task else 'robosuite'}"


def load_external(name: str) -> ExternalTask:
    """The task called `library/name`.

    Raises:
        UserError: no such library or task; the message lists those that exist.
    """
    library, _, environment = name.partition("/")
    if library not in LIBRARIES:
        raise UserError(
            f"task {shown(name)}: {unknown('library', library, LIBRARIES)}; a task is "
            "a name (see `manip list`), package.module:Class for a class of your own, "
            "or library/name"
        )
    return LIBRARIES[library](environment)
