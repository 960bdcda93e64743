"""A task of `dm_control.manipulation` as one world."""

import logging
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.errors import check_choice
from manip.robot_config import RobotConfig
from manip.sim.external.external_sim import ExternalSim, ExternalStep

# Its inverse kinematics warn of every start pose that is not perfect.
logging.getLogger("absl").addFilter(lambda record: record.levelno >= logging.ERROR)
_gl_backend = os.environ.get("MUJOCO_GL")
os.environ["MUJOCO_GL"] = "off"  # dm_control would open a window system to look
from dm_control import composer, manipulation  # noqa: E402
from dm_control.rl.control import PhysicsError  # noqa: E402

del os.environ["MUJOCO_GL"]
if _gl_backend is not None:
    os.environ["MUJOCO_GL"] = _gl_backend

Array = np.ndarray

ROBOT = RobotConfig("Jaco", "JOINT_VELOCITY", 25)
"""The only arm, action space and frequency of dm_control.manipulation."""

SOLVED = 1 - 1e-6
"""Reward from which an episode counts as successful: all tasks pay 1 at their goal, and
less everywhere else (dm_control.utils.rewards.tolerance)."""


def names() -> tuple[str, ...]:
    """Tasks that are observed in numbers, not in pictures."""
    return tuple(manipulation.get_environments_by_tag("features"))


def check_robot_config(robot: RobotConfig) -> None:
    """Raise `UserError` for any other than `ROBOT`."""
    for kind, asked, known in zip(RobotConfig._fields, robot, ROBOT, strict=True):
        check_choice(kind, str(asked), (str(known),))


class DmControlSim(ExternalSim):
    """A Jaco arm; reward in [0, 1] is dm_control's, success is a reward of 1."""

    def __init__(
        self, name: str, robot: RobotConfig, seed: int, hard_reset: bool
    ) -> None:
        # Without dm_control's own time limit; it compiles the model at every reset.
        self._env = composer.Environment(manipulation.load(name).task)
        spec = self._env.action_spec()
        self._low, self._range = spec.minimum, spec.maximum - spec.minimum

    def action_dim(self) -> int:
        """Six joints and three fingers."""
        return len(self._low)

    def start(self, seed: int) -> ExternalStep:
        """Restart the environment's random stream and reset it."""
        self._env.random_state.seed(seed)
        return self._sight(self._env.reset().observation, 0.0, False)

    def step(self, action: Array) -> ExternalStep | None:
        """Take an action, which spans the range of the joints' velocities."""
        scaled = self._low + (np.clip(action, -1, 1) + 1) / 2 * self._range
        try:
            step = self._env.step(scaled)
        except PhysicsError:
            return None
        over = step.last() and step.discount == 0
        return self._sight(step.observation, float(step.reward), over)

    def _sight(
        self, found: Mapping[str, Any], reward: float, over: bool
    ) -> ExternalStep:
        parts = {name: np.ravel(values) for name, values in found.items()}
        return ExternalStep(parts, reward, reward >= SOLVED, over)


open_world = DmControlSim
