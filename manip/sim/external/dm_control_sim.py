"""The tasks of `dm_control.manipulation`."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.cameras import CameraConfig
from manip.errors import check_choice
from manip.robot_config import RobotConfig
from manip.sim.external.external_sim import ExternalSim, ExternalStep
from manip.sim.gl import keep_mujoco_gl
from manip.sim.physics_cameras import PhysicsCameras
from manip.sim.robosuite_log import quiet

with keep_mujoco_gl("off"):  # else dm_control looks for a window system
    from dm_control import composer, manipulation
    from dm_control.rl.control import PhysicsError

Array = np.ndarray

ROBOT = RobotConfig("Jaco", "JOINT_VELOCITY", 25)
"""The only arm, action space and frequency of dm_control.manipulation."""

SOLVED = 1 - 1e-6
"""Reward from which an episode counts as successful: each task pays 1 at its goal and
less elsewhere (dm_control.utils.rewards.tolerance)."""


def names() -> tuple[str, ...]:
    """Tasks whose observations are numbers, not images."""
    return tuple(manipulation.get_environments_by_tag("features"))


def check_robot_config(robot: RobotConfig) -> None:
    """Raise `UserError` for any other than `ROBOT`."""
    kinds = "robot", "controller", "control_freq"
    for kind, chosen, known in zip(kinds, robot, ROBOT, strict=True):
        check_choice(kind, str(chosen), (str(known),))


class DmControlSim(ExternalSim):
    """A Jaco arm; reward in [0, 1] is dm_control's, success is a reward of 1."""

    def __init__(
        self,
        name: str,
        robot: RobotConfig,
        seed: int,
        hard_reset: bool,
        cameras: CameraConfig,
    ) -> None:
        # Without dm_control's own time limit; it compiles the model at every reset.
        self._env = composer.Environment(manipulation.load(name).task)
        spec = self._env.action_spec()
        self._low, self._range = spec.minimum, spec.maximum - spec.minimum
        self._images = PhysicsCameras(cameras)

    def action_dim(self) -> int:
        """Six joints and three fingers."""
        return len(self._low)

    def start(self, seed: int) -> ExternalStep:
        """Restart the environment's random stream and reset it."""
        self._env.random_state.seed(seed)
        with quiet("absl"):  # inverse kinematics warn of each imperfect start pose
            observation = self._env.reset().observation
        return self._external_step(observation, 0.0, False)

    def step(self, action: Array) -> ExternalStep | None:
        """Take an action, which is scaled to the range of the joint velocities."""
        scaled = self._low + (np.clip(action, -1, 1) + 1) / 2 * self._range
        try:
            step = self._env.step(scaled)
        except PhysicsError:
            return None
        over = step.last() and step.discount == 0
        return self._external_step(step.observation, float(step.reward), over)

    def _external_step(
        self, observation: Mapping[str, Any], reward: float, over: bool
    ) -> ExternalStep:
        parts = {name: np.ravel(values) for name, values in observation.items()}
        physics = self._env.physics
        images = self._images.draw(physics.model.ptr, physics.data.ptr)
        return ExternalStep(parts, reward, reward >= SOLVED, over, images)


open_sim = DmControlSim
