"""What tasks with one cube share: how it is sensed, measured and observed."""

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures
from manip.rewards.kernels import ramp
from manip.sim.scene import Scene
from manip.tasks.arm import observe_arm, start_qpos
from manip.tasks.objects import poses, rotation, turns, yaw

Array = np.ndarray

TABLE = np.array([0.0, 0.0, 0.8])
"""Centre of the table top [m] (robosuite/environments/manipulation/lift.py)."""
CENTRE = TABLE + np.array([0.0, 0.0, 0.15])
"""Origin [m] of the tool's place in observations."""
AROUND = 0.02
"""Distance [m] of the tool from the cube's centre, below which it is around it."""

CENTRED = 0.012
"""Distance [m] below which it is fully so."""

WIDTH = 0.044
"""Most that Lift's cube measures from face to face [m] (ibid.)."""
SLOW = 0.1
"""Change of a gripper's command in a control step, below which it is slow, and weak."""

CUBE = {"cube": "cube_main"}
PADS = {
    "left_touch": ("left_fingerpad", "cube_main"),
    "right_touch": ("right_fingerpad", "cube_main"),
}


def start_cube(
    scene: Scene, streams: EpisodeStreams, spots: Array, height: float
) -> Array:
    """[n, nq]: the arm at its start, the cube at `spots` [n, 2] m, with any yaw.

    height: of the cube's centre above the table [m].
    """
    qpos = start_qpos(scene, streams)
    qpos[:, scene.free_qpos("cube_main")] = poses(streams, spots, TABLE[2] + height)
    return qpos


def measure_cube(read: Measures) -> dict[str, Array]:
    """Add the cube's offset and distance from the tool, its height, its grasp.

    to_cube [N, 3] m, distance [N] m, height [N] m above the table; grasped [N] is
    robosuite's test, held [N] in [0, 1] falls to 0 as the tool slips off the cube.
    """
    to_cube = read["cube_pos"] - read["eef_pos"]
    distance = np.linalg.norm(to_cube, axis=1)
    grasped = (read["left_touch"] > 0) & (read["right_touch"] > 0)
    return {
        **read,
        "to_cube": to_cube,
        "distance": distance,
        "height": read["cube_pos"][:, 2] - TABLE[2],
        "grasped": grasped,
        "held": grasped * ramp(-distance, -AROUND, -CENTRED),
    }


def clumsy(m: Measures) -> bool:
    """Whether the hand is too wide or too weak to turn a cube as it closes on it."""
    wide, slow = m["gripper_narrowest"] > WIDTH, m["gripper_speed"] < SLOW
    return bool(wide | slow)


def turn_to_cube(m: Measures) -> Array:
    """[N] rad about the vertical, from the hand to the cube's next pair of faces.

    To its next pair of edges if the hand is wider than the cube.
    """
    edge = np.where(m["gripper_narrowest"] > WIDTH, np.pi / 4, 0.0)
    error = yaw(rotation(m["cube_quat"])) + edge - yaw(m["eef_mat"])
    return error - np.pi / 2 * np.round(error / (np.pi / 2))


def observe_cube(m: Measures) -> dict[str, Array]:
    """The arm, then the cube: place, turn, offset from the tool, velocity, touch.

    Clumsy hands see also how far they are turned from the cube, four times the angle.
    """
    turn = {"turn": turns(4 * turn_to_cube(m))} if clumsy(m) else {}
    return {
        **observe_arm(m, CENTRE),
        "cube_pos": 4.0 * (m["cube_pos"] - TABLE),
        "cube_quat": m["cube_quat"],
        "to_cube": np.clip(10.0 * m["to_cube"], -5.0, 5.0),
        "cube_linvel": m["cube_linvel"],
        "touch": np.stack([m["left_touch"], m["right_touch"]], axis=1),
        **turn,
    }


def closing(m: Measures) -> Array:
    """[N] in [0, 1]: how far the gripper is told to close, while it holds the cube."""
    return m["held"] * ramp(m["gripper_closing"], -1.0, 1.0)
