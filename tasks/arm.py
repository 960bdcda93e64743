"""The arm's part of every task: start pose, observation, grasp."""

import numpy as np

from manip.arrays import constant
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures
from manip.sim.scene import Scene
from manip.tasks.rotations import cos_sin, yaw_angle

Array = np.ndarray

JOINT_NOISE = 0.02
"""Standard deviation [rad] of the arm's start pose (robosuite/robots/robot.py)."""

ARM_PARTS = ("joint_pos", "joint_vel", "gripper_qpos", "gripper_closing", "eef_pos")
"""Parts of `observe_arm`, all of which a real arm measures itself."""
TOOL_PARTS = ("tool_yaw", "tool_tilt")
"""Parts that `observe_arm_and_tool` adds, which follow from the joint angles."""


def start_qpos(scene: Scene, streams: EpisodeStreams) -> Array:
    """[n, nq]: the default pose, with robosuite's noise on the arms' joints."""
    qpos = np.tile(scene.layout.qpos, (len(streams), 1))
    joints = scene.layout.joint_qpos
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
        "eef_pos": 4.0 * (m["eef_pos"] - constant(centre, m["eef_pos"])),
    }


def observe_arm_and_tool(m: Measures, centre: Array) -> dict[str, Array]:
    """As `observe_arm`, then the orientation of the tool.

    tool_yaw: cosine and sine of its yaw; tool_tilt: horizontal part of its axis * 3.
    """
    tool = m["eef_mat"]
    return {
        **observe_arm(m, centre),
        "tool_yaw": cos_sin(yaw_angle(tool)),
        "tool_tilt": 3.0 * tool[:, [2, 5]],
    }


def both_pads_touch(read: Measures) -> Array:
    """[N] bool: both finger pads touch the object (robosuite's `_check_grasp`)."""
    return (read["left_touch"] > 0) & (read["right_touch"] > 0)


def reach_factor(m: Measures) -> Array:
    """[N] in [0.5, 1]: factor of a reach reward.

    It is 1 with a firm grasp, and falls from 1 to 0.5 as an empty gripper closes.
    Without it, policies learned to rest closed fingers on top of the object, and did
    not improve from there.
    """
    return np.where(m["firm_grasp"], 1.0, 0.75 - 0.25 * m["gripper_closing"])


def near_joint_limit(read: Measures, margin: float) -> Array:
    """[N] bool: a joint of the arm is within `margin` [rad] of an end of its range."""
    above = read["joint_pos"] - read["joint_low"]
    below = read["joint_high"] - read["joint_pos"]
    return (np.minimum(above, below) <= margin).any(axis=1)
