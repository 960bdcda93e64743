"""What all tasks share: the arm's part of the observation, and the arm's reset."""

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures
from manip.sim.scene import Scene

Array = np.ndarray

JOINT_NOISE = 0.02
"""Standard deviation [rad] of the arm's start pose (robosuite/robots/robot.py)."""


def start_qpos(scene: Scene, streams: EpisodeStreams) -> Array:
    """[n, nq]: the default pose with robosuite's noise on the arm's joints."""
    qpos = np.tile(scene.layout.qpos, (len(streams), 1))
    joints = scene.layout.arm.qpos
    qpos[:, joints] += streams.normal(JOINT_NOISE, len(joints))
    return qpos


def observe_arm(m: Measures, centre: Array) -> dict[str, Array]:
    """The arm's part of an observation.

    joint_pos [rad] from the default pose; joint_vel [rad/s] * 0.3; gripper_qpos
    [m or rad] * 10; gripper_closing in [-1, 1]; eef_pos [m] from `centre` * 4.
    """
    return {
        "joint_pos": m["joint_pos"] - m["rest_pos"],
        "joint_vel": 0.3 * m["joint_vel"],
        "gripper_qpos": 10.0 * m["gripper_qpos"],
        "gripper_closing": m["gripper_closing"][:, None],
        "eef_pos": 4.0 * (m["eef_pos"] - centre),
    }


def ready(m: Measures) -> Array:
    """[N] in [0.5, 1]: 1 with the object held or the gripper open, else less.

    A factor for rewards of coming near: fingers that are closed around nothing come to
    rest on top of the object, and learn no better.
    """
    return np.where(m["held"], 1.0, 0.75 - 0.25 * m["gripper_closing"])


def yaw_quaternion(yaw: Array) -> Array:
    """[n, 4] wxyz: rotation by `yaw` [n] rad about the vertical."""
    zero = np.zeros_like(yaw)
    return np.stack([np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)], axis=1)
