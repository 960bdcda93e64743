"""ToolHang: stand a frame in a post, hang a wrench on its hook. robosuite's `ToolHang`.

Success: the post is upright, the tip of the frame's rod less than 5 cm from the centre
    of its base, the rod between its walls; the frame's bar runs through the wrench's
    hole and touches it; no finger touches the wrench (robosuite's tests).
Failure: none; an episode ends by its time limit.
Start: the post stands still; frame and wrench lie beside it, each within +-2 cm and
    10 degrees of its mean pose; arm in its default pose with 0.02 rad noise per joint,
    gripper half open.
Shaped reward, in [0, 1] per step: see `tool_hang_rewards`.
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Waypoint, Weights
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks import tool_hang_rewards as rewards
from manip.tasks.arm import ARM_PARTS, observe_arm, start_qpos
from manip.tasks.experts.tool_hang_expert import hang_tool
from manip.tasks.object_measures import tilt
from manip.tasks.offsets import coarse, fine
from manip.tasks.rotations import yaw_quaternion
from manip.tasks.tool_hang_measures import FINGERS, measure_parts, tip_depth
from manip.tasks.tool_hang_waypoints import NAMES, place_parts

Array = np.ndarray

CENTRE = np.array([-0.05, 0.0, 0.95])
"""Origin [m] of the observed tool position."""
STAND = np.array([-0.08, 0.0, 0.881, 1.0, 0.0, 0.0, 0.0])
"""Start pose of the stand (robosuite/environments/manipulation/tool_hang.py)."""
FRAME, TOOL = np.array([-0.04, -0.24, 0.8415]), np.array([0.04, -0.2, 0.841])
"""Mean start positions [m] of frame and wrench (ibid.)."""
SPREAD = np.array([0.02, 0.02, 0.0])
"""Half widths [m] of the boxes around them (ibid.)."""
FRAME_YAW, TOOL_YAW, YAW_SPREAD = -np.pi / 3, -np.pi / 2 - np.pi / 9, np.pi / 18
"""Mean yaws [rad] of frame and wrench, and half the range around them (ibid.)."""


class ToolHang(Task):
    """Stand the frame up, hang the wrench; see the module's docstring."""

    robosuite_name = "ToolHang"
    proprioception = (*ARM_PARTS, "tool_axes")
    sensors = Sensors(
        bodies={"stand": "stand_root", "frame": "frame_root", "tool": "tool_root"},
        sites={
            "tip": "frame_tip_site",
            "mount": "frame_mount_site",
            "corner": "frame_intersection_site",
            "hang": "frame_hang_site",
            "hole": "tool_hole1_center",
        },
        touches={
            "frame_left": ("left_fingerpad", "frame_root"),
            "frame_right": ("right_fingerpad", "frame_root"),
            **{f"tool_{finger}": (finger, "tool_root") for finger in FINGERS},
            "hole_touch": ("tool_hole1_root", "frame_horizontal_frame"),
        },
    )
    horizon = 400
    milestone_names = (
        "near_frame",
        "grasp_frame",
        "upright",
        "insert",
        "assembled",
        "near_tool",
        "grasp_tool",
        "carry",
        "hang",
        "success",
    )
    waypoint_names = NAMES
    weights: ClassVar[Weights] = rewards.WEIGHTS

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the poses of frame and wrench; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        qpos[:, scene.free_qpos("stand_root")] = STAND
        frame = FRAME + streams.uniform(-SPREAD, SPREAD, 3)
        lying = _lying_quaternion(_yaw(streams, FRAME_YAW))
        qpos[:, scene.free_qpos("frame_root")] = np.hstack([frame, lying])
        tool = TOOL + streams.uniform(-SPREAD, SPREAD, 3)
        turn = yaw_quaternion(_yaw(streams, TOOL_YAW))
        qpos[:, scene.free_qpos("tool_root")] = np.hstack([tool, turn])
        return Start(qpos)

    def sample_waypoint(
        self, milestone: str, scene: Scene, streams: EpisodeStreams
    ) -> Waypoint:
        """See `manip.tasks.tool_hang_waypoints`."""
        start = self.sample_start(scene, streams)
        frame, tool = (scene.free_qpos(f"{name}_root") for name in ("frame", "tool"))
        return place_parts(milestone, streams, start, frame, tool)

    def measure(self, read: Measures) -> Measures:
        """See `measure_parts`."""
        return measure_parts(read)

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and the tool's axes, then frame and wrench, coarse and fine."""
        parts = {**observe_arm(m, CENTRE), "tool_axes": m["eef_mat"]}
        for name in "to_grip", "to_mouth", "to_tool", "to_hook":
            parts[name] = coarse(m[name])
            parts[f"{name}_fine"] = fine(m[name])
        for name in "frame", "tool":
            parts[f"{name}_axes"] = m[f"{name}_mat"]
            parts[f"{name}_linvel"] = m[f"{name}_linvel"]
            parts[f"{name}_angvel"] = 0.2 * m[f"{name}_angvel"]
        flags = *self.sensors.touches, "assembled", "threaded"
        parts["flags"] = np.stack([m[name] for name in flags], axis=1).astype(float)
        return parts

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        return rewards.TERMS[reward](m, self.success(m))

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's, then those of frame and wrench (named tool).

        grip_distance and tool_distance [N] m from the gripper to them; frame_speed and
        tool_speed [N] m/s; frame_tilt and tool_tilt [N] rad, see `tilt`; assembled,
        threaded [N], 0 or 1.
        """
        return {
            **super().visible_measures(m),
            **{name: m[name] for name in ("grip_distance", "tool_distance")},
            **{f"{b}_speed": _speed(m[f"{b}_linvel"]) for b in ("frame", "tool")},
            **{f"{b}_tilt": tilt(m[f"{b}_mat"]) for b in ("frame", "tool")},
            **{name: 1.0 * m[name] for name in ("assembled", "threaded")},
        }

    def success(self, m: Measures) -> Array:
        """The frame stands, and the wrench hangs on it, not grasped."""
        return m["assembled"] & m["hung"]

    def expert(self, m: Measures) -> Array:
        """See `manip.tasks.experts.tool_hang_expert`."""
        return hang_tool(m)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: within 5 cm; upright: to 15 degrees; carry: hole 3 cm from the hook."""
        upright = m["frame_firm_grasp"] & (m["frame_mat"][:, 8] > np.cos(np.pi / 12))
        at_hook = np.linalg.norm(m["to_hook"], axis=1) < 0.03
        return {
            "near_frame": m["grip_distance"] < 0.05,
            "grasp_frame": m["frame_firm_grasp"],
            "upright": upright,
            "insert": upright & (tip_depth(m) > 0.01),
            "assembled": m["assembled"],
            "near_tool": m["assembled"] & (m["tool_distance"] < 0.05),
            "grasp_tool": m["assembled"] & m["tool_firm_grasp"],
            "carry": m["assembled"] & m["tool_firm_grasp"] & at_hook,
            "hang": m["assembled"] & m["threaded"],
            "success": self.success(m),
        }


def _yaw(streams: EpisodeStreams, mean: float) -> Array:
    """[n] rad: yaws uniform around `mean`."""
    return streams.uniform(mean - YAW_SPREAD, mean + YAW_SPREAD, 1)[:, 0]


def _lying_quaternion(yaw: Array) -> Array:
    """[n, 4] wxyz: the frame flat on the table, turned by `yaw` [n] rad."""
    angle = np.pi / 4 + yaw / 2
    sin, cos = np.sin(angle), np.cos(angle)
    return np.stack([sin, -sin, -cos, cos], axis=1) / np.sqrt(2)


def _speed(velocity: Array) -> Array:
    """[n] m/s: length of velocities [n, 3] m/s."""
    return np.linalg.norm(velocity, axis=1)
