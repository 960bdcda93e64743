"""robosuite's observations, computed from the readings of the batch engine."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from manip.sim.robot_model import Robot, reading_prefix
from manip.sim.scene import Scene
from manip.tasks.tool_hang import ToolHang
from manip.tasks.tool_hang_measures import BASE, CORNER
from manip.tasks.two_arm_peg_in_hole import TwoArmPegInHole
from manip.tasks.wipe import TABLE
from manip.tasks.wipe_markers import MARKERS

Array = np.ndarray


def wxyz_to_xyzw(quaternion: Array) -> Array:
    return quaternion[[1, 2, 3, 0]]


Reading = Callable[[dict[str, Array], Scene], Array]


def robot_readings(scene: Scene) -> dict[str, Reading]:
    """What robosuite observes of the robots, but what follows from it."""
    return {
        f"robot{number}_{name}": read
        for number, robot in enumerate(scene.layout.robots)
        for name, read in _of_robot(reading_prefix(number), robot).items()
        if scene.stock.robots[number].has_gripper["right"] or "gripper" not in name
    }


def _of_robot(prefix: str, robot: Robot) -> dict[str, Reading]:
    return {
        "joint_pos": lambda r, s: r[f"{prefix}joint_pos"][0],
        "joint_vel": lambda r, s: r[f"{prefix}joint_vel"][0],
        "joint_acc": lambda r, s: r["qacc"][0, robot.arm.dof],
        "eef_pos": lambda r, s: r[f"{prefix}eef_pos"][0],
        "eef_quat": lambda r, s: wxyz_to_xyzw(r[f"{prefix}hand_quat"][0]),
        "gripper_qpos": lambda r, s: r[f"{prefix}gripper_qpos"][0],
        "gripper_qvel": lambda r, s: r[f"{prefix}gripper_qvel"][0],
    }


def turned(quaternion: Array) -> Rotation:
    return Rotation.from_quat(quaternion, scalar_first=True)


def relative_to_hand(r: dict[str, Array], body: str, local: Array) -> Array:
    """Pose [7] of a body relative to the hand, as robosuite observes.

    robosuite computes them before it reads the body: they belong to the present hand
    and to the body one step ago, and are zero at a reset.
    """
    if f"last_{body}_pos" not in r:
        return np.zeros(7)
    hand, body_turn = turned(r["hand_quat"][0]).inv(), turned(r[f"last_{body}_quat"][0])
    point = r[f"last_{body}_pos"][0] + body_turn.apply(local)
    turn = (hand * body_turn).as_quat(canonical=True)
    return np.concatenate([hand.apply(point - r["eef_pos"][0]), turn])


def pose_readings(
    theirs: str, ours: str, local: Array | None = None
) -> dict[str, Reading]:
    """Of a body, or of a `local` point of it: in the world frame and from the hand.

    robosuite makes the quaternion of such a point from a matrix, with positive w.
    """
    at = np.zeros(3) if local is None else local
    body, quat = f"{ours}_pos", f"{ours}_quat"
    return {
        f"{theirs}_pos": lambda r, s: r[body][0] + turned(r[quat][0]).apply(at),
        f"{theirs}_quat": lambda r, s: (
            wxyz_to_xyzw(r[quat][0])
            if local is None
            else turned(r[quat][0]).as_quat(canonical=True)
        ),
        f"{theirs}_to_robot0_eef_pos": lambda r, s: relative_to_hand(r, ours, at)[:3],
        f"{theirs}_to_robot0_eef_quat": lambda r, s: relative_to_hand(r, ours, at)[3:],
    }


def dirt(r: dict[str, Array]) -> tuple[Array, float]:
    """Mean place of what was left of the dirt before a step, and its radius."""
    places = TABLE + np.stack([r[f"marker{i}"][0] for i in range(MARKERS)])
    left = places[r["was_wiped"][0] == 0]
    centre = left.mean(axis=0) if len(left) else np.zeros(3)
    return centre, np.linalg.norm(left - centre, axis=1).max(initial=0.0)


def hanging(name: str) -> Reading:
    return lambda r, s: float(ToolHang().measure(r)[name][0])


CUBE: dict[str, Reading] = {
    "cube_pos": lambda r, s: r["cube_pos"][0],
    "cube_quat": lambda r, s: wxyz_to_xyzw(r["cube_quat"][0]),
    "gripper_to_cube_pos": lambda r, s: r["cube_pos"][0] - r["eef_pos"][0],
}

CUBE_AND_GOAL: dict[str, Reading] = CUBE | {
    "goal_pos": lambda r, s: r["goal_pos"][0],
    "cube_to_goal_pos": lambda r, s: r["goal_pos"][0] - r["cube_pos"][0],
}

OBJECT_READINGS: dict[str, dict[str, Reading]] = {
    "Door": {
        "door_pos": lambda r, s: r["door_pos"][0],
        "handle_pos": lambda r, s: r["handle_pos"][0],
        "door_to_eef_pos": lambda r, s: r["door_pos"][0] - r["eef_pos"][0],
        "handle_to_eef_pos": lambda r, s: r["handle_pos"][0] - r["eef_pos"][0],
        "hinge_qpos": lambda r, s: r["hinge_qpos"][0, 0],
        "handle_qpos": lambda r, s: r["handle_qpos"][0, 0],
    },
    "Lift": CUBE,
    "NutAssembly": {
        **pose_readings("SquareNut", "Square_nut"),
        **pose_readings("RoundNut", "Round_nut"),
    },
    "NutAssemblyRound": pose_readings("RoundNut", "nut"),
    "NutAssemblySquare": pose_readings("SquareNut", "nut"),
    "PickGoal": CUBE_AND_GOAL,
    "PickPlace": {
        theirs: reading
        for name in ("Milk", "Bread", "Cereal", "Can")
        for theirs, reading in pose_readings(name, f"{name}_object").items()
    },
    "PickPlaceBread": pose_readings("Bread", "object"),
    "PickPlaceCan": pose_readings("Can", "object"),
    "PickPlaceCereal": pose_readings("Cereal", "object"),
    "PickPlaceMilk": pose_readings("Milk", "object"),
    "Push": CUBE_AND_GOAL,
    "Reach": {
        "goal_pos": lambda r, s: r["goal_pos"][0],
        "gripper_to_goal_pos": lambda r, s: r["goal_pos"][0] - r["eef_pos"][0],
    },
    "Stack": {
        "cubeA_pos": lambda r, s: r["a_pos"][0],
        "cubeA_quat": lambda r, s: wxyz_to_xyzw(r["a_quat"][0]),
        "cubeB_pos": lambda r, s: r["b_pos"][0],
        "cubeB_quat": lambda r, s: wxyz_to_xyzw(r["b_quat"][0]),
        "cubeA_to_cubeB": lambda r, s: r["b_pos"][0] - r["a_pos"][0],
        "gripper_to_cubeA": lambda r, s: r["a_pos"][0] - r["eef_pos"][0],
        "gripper_to_cubeB": lambda r, s: r["b_pos"][0] - r["eef_pos"][0],
    },
    "ToolHang": {
        **pose_readings("base", "stand", BASE),
        **pose_readings("frame", "frame", CORNER),
        **pose_readings("tool", "tool", np.zeros(3)),
        "frame_is_assembled": hanging("assembled"),
        "tool_on_frame": hanging("hung"),
    },
    "TwoArmLift": {
        "pot_pos": lambda r, s: r["pot_pos"][0],
        "pot_quat": lambda r, s: wxyz_to_xyzw(r["pot_quat"][0]),
        "handle0_xpos": lambda r, s: r["handle0_pos"][0],
        "handle1_xpos": lambda r, s: r["handle1_pos"][0],
        "gripper0_to_handle0": lambda r, s: r["handle0_pos"][0] - r["eef_pos"][0],
        "gripper1_to_handle1": lambda r, s: (
            r["handle1_pos"][0] - r["robot1_eef_pos"][0]
        ),
    },
    "TwoArmPegInHole": {
        "hole_pos": lambda r, s: r["hole_pos"][0],
        "hole_quat": lambda r, s: wxyz_to_xyzw(r["hole_quat"][0]),
        "peg_to_hole": lambda r, s: r["hole_pos"][0] - r["peg_pos"][0],
        "peg_quat": lambda r, s: wxyz_to_xyzw(r["peg_quat"][0]),
        "angle": lambda r, s: TwoArmPegInHole().measure(r)["cos"][0],
        "t": lambda r, s: TwoArmPegInHole().measure(r)["along"][0],
        "d": lambda r, s: TwoArmPegInHole().measure(r)["aside"][0],
    },
    "Wipe": {
        "proportion_wiped": lambda r, s: r["was_wiped"].mean(),
        "wipe_centroid": lambda r, s: dirt(r)[0],
        "wipe_radius": lambda r, s: dirt(r)[1],
        "gripper_to_wipe_centroid": lambda r, s: dirt(r)[0] - r["eef_pos"][0],
    },
}
