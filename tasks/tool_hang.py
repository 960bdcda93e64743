"""ToolHang: stand a frame with a hook in its post, hang a wrench on it. robosuite's.

Success: the post is upright, the tip of the frame's rod less than 5 cm from the centre
    of its base, the rod between its walls; the frame's bar runs through the wrench's
    hole and touches it; no finger touches the wrench (robosuite's tests).
Failure: none; an episode ends by time.
Start: the post stands still; frame and wrench lie beside it, each within +-2 cm and
    10 degrees of its place; arm in its default pose with 0.02 rad noise a joint,
    gripper half open.
Shaped reward, in [0, 1] a step: 0.05 reach_frame + 0.05 grasp_frame + 0.1 upright
    + 0.1 over + 0.2 insert for the frame; then, once it stands, these in full, and
    0.05 leave + 0.05 reach_tool + 0.1 grasp_tool + 0.15 carry + 0.05 hang
    + 0.05 release + 0.05 stay for the wrench. Reaching pays 1 - tanh(5 d) of the
    distance d [m] to the grip; grasping rises from 0 to 1 as the gripper is told to
    close, and is paid, as upright, over and carry, only while both finger pads touch
    the object and d < 3 cm. Upright rises as the rod turns downwards; over is upright
    times the nearness of its tip to the post's mouth, insert the tip's depth in it;
    leave rises as the gripper opens or goes; carry is the nearness of the wrench's
    hole to the hook; hang is paid while the bar runs through it, and release as the
    gripper then opens.
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near, ramp
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import observe_arm, start_qpos, yaw_quaternion
from manip.tasks.experts.tool_hang import tool_hang
from manip.tasks.hanging import GRIP, HOOK, MOUTH, assembled, place, threaded
from manip.tasks.objects import rotation

Array = np.ndarray

CENTRE = np.array([-0.05, 0.0, 0.95])
"""Origin [m] of the tool's place in observations."""
STAND = np.array([-0.08, 0.0, 0.881, 1.0, 0.0, 0.0, 0.0])
"""Where the stand starts (robosuite/environments/manipulation/tool_hang.py)."""
FRAME, TOOL = np.array([-0.04, -0.24, 0.8415]), np.array([0.04, -0.2, 0.841])
"""Mean places [m] of frame and wrench (ibid.)."""
SPREAD = np.array([0.02, 0.02, 0.0])
"""Half widths [m] about them (ibid.)."""
FRAME_TURN, TOOL_TURN, TURN = -np.pi / 3, -np.pi / 2 - np.pi / 9, np.pi / 18
"""Mean turns [rad] of frame and wrench, and half the range about them (ibid.)."""
AROUND = 0.03
"""Distance [m] of the gripper from a grip's centre, below which it is around it."""
DEPTH = 0.15
"""Depth [m] of the post."""
BORE = 0.005
"""Half width [m] of the post's inside (ibid.)."""
FINGERS = ("left_fingerpad", "right_fingerpad", "left_finger", "right_finger")
"""Parts of a gripper that must not touch the wrench for success."""


class ToolHang(Task):
    """Stand the frame up, hang the wrench; see the module's docstring."""

    robosuite_name = "ToolHang"
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
    weights: ClassVar[Weights] = {
        "shaped": {
            "reach_frame": 0.05,
            "grasp_frame": 0.05,
            "upright": 0.1,
            "over": 0.1,
            "insert": 0.2,
            "leave": 0.05,
            "reach_tool": 0.05,
            "grasp_tool": 0.1,
            "carry": 0.15,
            "hang": 0.05,
            "release": 0.05,
            "stay": 0.05,
        },
        "stock": {"success": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Place stand, frame and wrench; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        qpos[:, scene.free_qpos("stand_root")] = STAND
        frame = FRAME + streams.uniform(-SPREAD, SPREAD, 3)
        turn = streams.uniform(FRAME_TURN - TURN, FRAME_TURN + TURN, 1)[:, 0]
        lying = _lying_quaternion(turn)
        qpos[:, scene.free_qpos("frame_root")] = np.hstack([frame, lying])
        tool = TOOL + streams.uniform(-SPREAD, SPREAD, 3)
        turn = streams.uniform(TOOL_TURN - TURN, TOOL_TURN + TURN, 1)[:, 0]
        qpos[:, scene.free_qpos("tool_root")] = np.hstack([tool, yaw_quaternion(turn)])
        return Start(qpos)

    def measure(self, read: Measures) -> Measures:
        """Add how things are turned, offsets between them, and what is held.

        stand_mat, frame_mat, tool_mat [N, 9]; to_grip and to_tool [N, 3] m from the
        gripper to the frame's and the wrench's grip, grip_distance and tool_distance
        [N] m; to_mouth [N, 3] m from the rod's tip to the post's mouth, to_hook
        [N, 3] m from the wrench's hole to the hook; frame_held and tool_held [N] ask
        for robosuite's grasp with the gripper around the grip; assembled and threaded
        [N] see `tasks.hanging`; hung [N]: the wrench hangs on the frame by itself.
        """
        mats = {f"{b}_mat": rotation(read[f"{b}_quat"]) for b in self.sensors.bodies}
        m = {**read, **mats}
        m["to_grip"] = place(m["frame_pos"], m["frame_mat"], GRIP) - m["eef_pos"]
        m["to_tool"] = m["tool_pos"] - m["eef_pos"]
        m["grip_distance"] = np.linalg.norm(m["to_grip"], axis=1)
        m["tool_distance"] = np.linalg.norm(m["to_tool"], axis=1)
        m["to_mouth"] = place(m["stand_pos"], m["stand_mat"], MOUTH) - m["tip_pos"]
        m["to_hook"] = place(m["frame_pos"], m["frame_mat"], HOOK) - m["hole_pos"]
        held = (m["frame_left"] > 0) & (m["frame_right"] > 0)
        m["frame_held"] = held & (m["grip_distance"] < AROUND)
        held = (m["tool_left_fingerpad"] > 0) & (m["tool_right_fingerpad"] > 0)
        m["tool_held"] = held & (m["tool_distance"] < AROUND)
        m["assembled"], m["threaded"] = assembled(m), threaded(m)
        touched = np.any([m[f"tool_{finger}"] > 0 for finger in FINGERS], axis=0)
        m["hung"] = m["threaded"] & (m["hole_touch"] > 0) & ~touched
        return m

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and how it is turned, then frame and wrench, coarse and fine."""
        parts = {**observe_arm(m, CENTRE), "tool_axes": m["eef_mat"]}
        for name in "to_grip", "to_mouth", "to_tool", "to_hook":
            parts[name] = 10.0 * np.clip(m[name], -0.3, 0.3)
            parts[f"{name}_fine"] = 50.0 * np.clip(m[name], -0.02, 0.02)
        for name in "frame", "tool":
            parts[f"{name}_axes"] = m[f"{name}_mat"]
            parts[f"{name}_linvel"] = m[f"{name}_linvel"]
            parts[f"{name}_angvel"] = 0.2 * m[f"{name}_angvel"]
        flags = *self.sensors.touches, "assembled", "threaded"
        parts["flags"] = np.stack([m[name] for name in flags], axis=1).astype(float)
        return parts

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        done = self.success(m)
        if reward == "stock":
            return {"success": done.astype(float)}
        stands = {"leave": _left(m), **_tool_terms(m, done)}
        return {
            **{k: np.maximum(m["assembled"], v) for k, v in _frame_terms(m).items()},
            **{k: np.maximum(done, m["assembled"] * v) for k, v in stands.items()},
        }

    def success(self, m: Measures) -> Array:
        """The frame stands, and the wrench hangs on it by itself."""
        return m["assembled"] & m["hung"]

    def expert(self, m: Measures) -> Array:
        """As `manip.tasks.experts.tool_hang`."""
        return tool_hang(m)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: within 5 cm; upright: to 15 degrees; carry: hole 3 cm from the hook."""
        upright = m["frame_held"] & (m["frame_mat"][:, 8] > np.cos(np.pi / 12))
        carried = np.linalg.norm(m["to_hook"], axis=1) < 0.03
        return {
            "near_frame": m["grip_distance"] < 0.05,
            "grasp_frame": m["frame_held"],
            "upright": upright,
            "insert": upright & (_depth(m) > 0.01),
            "assembled": m["assembled"],
            "near_tool": m["assembled"] & (m["tool_distance"] < 0.05),
            "grasp_tool": m["assembled"] & m["tool_held"],
            "carry": m["assembled"] & m["tool_held"] & carried,
            "hang": m["assembled"] & m["threaded"],
            "success": self.success(m),
        }


def _frame_terms(m: Measures) -> dict[str, Array]:
    held = m["frame_held"].astype(float)
    upright = held * (1 + m["frame_mat"][:, 8]) / 2
    at_mouth = near(np.linalg.norm(m["to_mouth"], axis=1), 0.1)
    return {
        "reach_frame": near(m["grip_distance"], 0.2),
        "grasp_frame": held * ramp(m["gripper_closing"], -1.0, 1.0),
        "upright": upright,
        "over": upright * np.maximum(at_mouth, _depth(m) > 0),
        "insert": held * ramp(_depth(m), 0.0, DEPTH),
    }


def _tool_terms(m: Measures, done: Array) -> dict[str, Array]:
    held, on = m["tool_held"], m["threaded"]
    carry = held * near(np.linalg.norm(m["to_hook"], axis=1), 0.2)
    return {
        "reach_tool": np.maximum(on, near(m["tool_distance"], 0.2)),
        "grasp_tool": np.maximum(on, held * ramp(m["gripper_closing"], -1.0, 1.0)),
        "carry": np.maximum(on, carry),
        "hang": on.astype(float),
        "release": on * ramp(-m["gripper_closing"], -1.0, 1.0),
        "stay": done.astype(float),
    }


def _left(m: Measures) -> Array:
    """[N] in [0, 1]: how far the gripper has opened around the frame, or gone."""
    opened = ramp(-m["gripper_closing"], -1.0, 1.0)
    return np.maximum(opened, ramp(m["grip_distance"], AROUND, 2 * AROUND))


def _depth(m: Measures) -> Array:
    """[N] m: how deep the rod's tip is in the post, 0 where it is beside it."""
    inside = (np.abs(m["to_mouth"][:, :2]) < BORE).all(axis=1)
    return inside * np.maximum(m["to_mouth"][:, 2], 0.0)


def _lying_quaternion(turn: Array) -> Array:
    """[n, 4] wxyz: the frame flat on the table, turned by `turn` [n] rad."""
    angle = np.pi / 4 + turn / 2
    sin, cos = np.sin(angle), np.cos(angle)
    return np.stack([sin, -sin, -cos, cos], axis=1) / np.sqrt(2)
