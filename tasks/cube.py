"""The cube of Lift, Push and PickGoal: sensors, measures, observation, grasp term."""

import numpy as np

from manip.arrays import constant, namespace
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Waypoint
from manip.rewards.kernels import ramp
from manip.sim.scene import Scene
from manip.tasks.arm import both_pads_touch, observe_arm, start_qpos
from manip.tasks.held_objects import GraspSpread, grasp, nearest_yaw
from manip.tasks.placement import poses_with_any_yaw
from manip.tasks.rotations import cos_sin, nearest_turn, rotation_matrix, yaw_angle

Array = np.ndarray

TABLE = np.array([0.0, 0.0, 0.8])
"""Centre of the table top [m] (robosuite/environments/manipulation/lift.py)."""
CENTRE = TABLE + np.array([0.0, 0.0, 0.15])
"""Origin [m] of the observed tool position."""

GRASP_FAR = 0.02
"""Distance [m] of the tool from the cube's centre at which grasp_quality is 0."""
GRASP_NEAR = 0.012
"""Distance [m] up to which grasp_quality is 1."""

CUBE_WIDTH = 0.044
"""Largest width [m] of Lift's cube, from face to face (ibid.)."""
CUBE_DIAGONAL = CUBE_WIDTH * np.sqrt(2)
"""Its largest width [m], from edge to edge."""
SLOW_GRIPPER = 0.1
"""Change of the gripper's command per control step below which it is slow and weak."""

CUBE_BODY = {"cube": "cube_main"}
PAD_TOUCHES = {
    "left_touch": ("left_fingerpad", "cube_main"),
    "right_touch": ("right_fingerpad", "cube_main"),
}


def start_cube(
    scene: Scene, streams: EpisodeStreams, spots: Array, height: float
) -> Array:
    """[n, nq]: the arm at its start, the cube at `spots` [n, 2] m, yaw uniform.

    height: of the cube's centre above the table [m].
    """
    qpos = start_qpos(scene, streams)
    cube = poses_with_any_yaw(streams, spots, TABLE[2] + height)
    qpos[:, scene.free_qpos("cube_main")] = cube
    return qpos


def grasp_cube(scene: Scene, streams: EpisodeStreams, start: Start) -> Waypoint:
    """The closed hand around the upright cube, wherever the start states have it."""
    cube = start.qpos[:, scene.free_qpos("cube_main")]
    turned = 2 * np.arctan2(cube[:, 6], cube[:, 3])
    yaw = nearest_yaw(turned + _gripped_turn(scene.layout.narrowest), 4)
    spread = GraspSpread((0.004, 0.004, 0.006))
    return grasp(streams, start, cube[:, :3], yaw, spread)


def measure_cube(read: Measures) -> dict[str, Array]:
    """Add the cube's offset and distance from the tool, its height, and the grasp.

    to_cube [N, 3] m; distance [N] m; height [N] m above the table; grasped [N] bool,
    robosuite's test; grasp_quality [N] in [0, 1], which is 0 without a grasp and falls
    from 1 to 0 as the tool slips off the cube's centre.
    """
    to_cube = read["cube_pos"] - read["eef_pos"]
    distance = namespace(to_cube).linalg.norm(to_cube, axis=1)
    grasped = both_pads_touch(read)
    return {
        **read,
        "to_cube": to_cube,
        "distance": distance,
        "height": read["cube_pos"][:, 2] - TABLE[2],
        "grasped": grasped,
        "grasp_quality": grasped * ramp(-distance, -GRASP_FAR, -GRASP_NEAR),
    }


def must_align(m: Measures) -> bool:
    """Whether the hand is too wide or too weak to turn a cube as it closes on it.

    Such a gripper must align with the cube's faces or edges before it closes.
    """
    wide = _too_wide(m["gripper_narrowest"])
    slow = m["gripper_speed"] < SLOW_GRIPPER
    return bool(wide | slow)


def yaw_matters(m: Measures) -> bool:
    """Whether the hand grasps a cube at some yaws only.

    Either it must align, or the open gripper is narrower than the cube's diagonal, so
    that its fingers come down on a cube that is turned by 45 degrees.
    """
    return must_align(m) or bool(m["gripper_widest"] < CUBE_DIAGONAL)


def yaw_to_cube(m: Measures) -> Array:
    """[N] rad about the vertical, from the hand to the cube's nearest pair of faces.

    For a hand that is wider than the cube: to its nearest pair of edges.
    """
    yaw = yaw_angle(rotation_matrix(m["cube_quat"]))
    turn = constant(_gripped_turn(m["gripper_narrowest"]), yaw)
    return nearest_turn(yaw + turn - yaw_angle(m["eef_mat"]), np.pi / 2)


def _gripped_turn(narrowest: Array | float) -> Array:
    """[rad] from a cube to a hand that grips it: by its faces, or edges if too wide.

    narrowest: gap [m] between the pads of the shut gripper.
    """
    return np.where(_too_wide(narrowest), np.pi / 4, 0.0)


def _too_wide(narrowest: Array | float) -> Array | bool:
    """Whether the shut gripper does not touch the faces of the cube."""
    return narrowest > CUBE_WIDTH


def observe_cube(m: Measures) -> dict[str, Array]:
    """The arm, then the cube: position, rotation, offset, velocity, touches.

    A hand whose yaw matters also observes four times its yaw to the cube.
    """
    xp, position = namespace(m["cube_pos"]), m["cube_pos"]
    turn = {"turn": cos_sin(4 * yaw_to_cube(m))} if yaw_matters(m) else {}
    return {
        **observe_arm(m, CENTRE),
        "cube_pos": 4.0 * (position - constant(TABLE, position)),
        "cube_quat": m["cube_quat"],
        "to_cube": xp.clip(10.0 * m["to_cube"], -5.0, 5.0),
        "cube_linvel": m["cube_linvel"],
        "touch": xp.stack([m["left_touch"], m["right_touch"]], axis=1),
        **turn,
    }


def grasp_term(m: Measures) -> Array:
    """[N] in [0, 1]: grasp quality times how far the gripper's command is closed."""
    return m["grasp_quality"] * ramp(m["gripper_closing"], -1.0, 1.0)
