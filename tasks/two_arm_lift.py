"""TwoArmLift: two robots raise a pot by its handles. robosuite's `TwoArmLift`.

Success: the pot's bottom is more than 10 cm above the table top (robosuite's test).
Failure: none; an episode ends by its time limit.
Start: pot centre uniform within +-3 cm of the table's centre, yaw uniform within 60
    degrees of half a turn; arms in their default pose with 0.02 rad noise per joint,
    grippers half open.
Shaped reward, in [0, 1] per step: 0.2 reach + 0.3 grasp + 0.5 lift. reach and grasp are
means over the two robots, of which each has its own handle.
    reach: 1 - tanh(5 d) of the distance d [m] from the tool to the handle.
    grasp: 0 unless both finger pads touch the handle. Rises from 0 to 1 as the
        gripper's command goes from open to closed.
    lift: rises linearly over the first 12 cm of height, times a factor: 1 for a tilt of
        the pot below 0.1 rad, falling to 0 at 0.5 rad.
"""

from typing import ClassVar

import numpy as np

from manip.arrays import floats
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near, ramp
from manip.sim.robot_model import reading_prefix
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import start_qpos
from manip.tasks.experts.two_arm_lift_expert import lift_pot
from manip.tasks.object_measures import tilt
from manip.tasks.offsets import coarse, fine
from manip.tasks.rotations import cos_sin, rotation_matrix, yaw_angle, yaw_quaternion
from manip.tasks.two_arms import (
    ROBOT_PARTS,
    ROBOTS,
    measure_robots,
    observe_robots,
    of_robot,
)

Array = np.ndarray

TABLE = np.array([0.0, 0.0, 0.8])
"""Centre of the table top [m] (robosuite/environments/manipulation/two_arm_lift.py)."""
SPREAD = 0.03
"""Half width [m] of the square in which the pot starts (ibid.)."""
TURN = np.pi / 3
"""Largest difference [rad] of the pot's yaw from half a turn (ibid.)."""
SUCCESS_HEIGHT = 0.10
"""Height [m] of the pot's bottom above the table, for success (ibid.)."""
MOST_TILT = np.pi / 6
"""Tilt [rad] of the pot from which robosuite pays nothing for its height (ibid.)."""
HALF = 0.07
"""Half height [m] of the pot (models/objects/composite/pot_with_handles.py)."""
CENTRE = np.array([0.0, 0.0, 0.95])
"""Point [m] from which the positions of the tools are observed."""
BARS = ("c", "-", "+")
"""Bars of a handle: in the centre, and on both sides."""


def _touches() -> dict[str, tuple[str, str]]:
    """Of each robot, each finger pad with each bar of the robot's handle."""
    return {
        f"{prefix}{side}_touch_{bar}": (
            f"{prefix}{side}_fingerpad",
            f"pot_handle{number}_{bar}",
        )
        for number, prefix in enumerate(map(reading_prefix, ROBOTS))
        for side in ("left", "right")
        for bar in BARS
    }


class TwoArmLift(Task):
    """Raise the pot; see the module's docstring for the numbers."""

    robosuite_name = "TwoArmLift"
    sensors = Sensors(
        bodies={"pot": "pot_root"},
        sites={"handle0": "pot_handle0", "handle1": "pot_handle1"},
        touches=_touches(),
    )
    horizon = 100
    milestone_names = ("near", "grasp_one", "grasp", "lift")
    proprioception = ROBOT_PARTS
    weights: ClassVar[Weights] = {
        "shaped": {"reach": 0.2, "grasp": 0.3, "lift": 0.5},
        "stock": {"reach": 1 / 3, "grasp": 1 / 6, "lift": 0.5, "success": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the pot's pose; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        spread = np.array([SPREAD, SPREAD, 0.0])
        spot = TABLE + np.array([0.0, 0.0, HALF])
        position = spot + streams.uniform(-spread, spread, 3)
        turn = yaw_quaternion(np.pi + streams.uniform(-TURN, TURN, 1)[:, 0])
        qpos[:, scene.free_qpos("pot_root")] = np.column_stack([position, turn])
        return Start(qpos)

    def measure(self, read: Measures) -> Measures:
        """Add the height of the pot and how each robot holds it.

        height [N] m of the pot's bottom above the table; pot_tilt [N] rad; for each
        robot to_handle [N, 3] m from the tool, distance [N] m, its length, and grasped
        [N] bool, robosuite's test.
        """
        return {
            **measure_robots(read, _measure_robot),
            "height": read["pot_pos"][:, 2] - HALF - TABLE[2],
            "pot_tilt": tilt(rotation_matrix(read["pot_quat"])),
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The robots, then the pot: pose, velocity, offsets of the handles, touches."""
        pot = rotation_matrix(m["pot_quat"])
        robots = [of_robot(m, number) for number in ROBOTS]
        return {
            **observe_robots(m, CENTRE),
            "pot_pos": 4.0 * (m["pot_pos"] - TABLE - [0.0, 0.0, HALF]),
            "pot_yaw": cos_sin(yaw_angle(pot)),
            "pot_upright": 3.0 * pot[:, 6:8],
            "pot_linvel": m["pot_linvel"],
            "pot_angvel": 0.2 * m["pot_angvel"],
            "to_handles": np.hstack([coarse(own["to_handle"]) for own in robots]),
            "to_handles_fine": np.hstack([fine(own["to_handle"]) for own in robots]),
            "touch": np.column_stack(
                [own[side] for own in robots for side in ("left", "right")]
            ),
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        robots = [of_robot(m, number) for number in ROBOTS]
        return _stock_terms(m, robots) if reward == "stock" else _shaped(m, robots)

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """Those of the first hand; those of the pot; number of hands that hold it.

        object_height [N] m of its bottom; object_speed [N] m/s; object_tilt [N] rad;
        hands [N].
        """
        robots = [of_robot(m, number) for number in ROBOTS]
        return {
            **super().visible_measures(m),
            "object_height": m["height"],
            "object_speed": np.linalg.norm(m["pot_linvel"], axis=1),
            "object_tilt": m["pot_tilt"],
            "hands": np.sum([own["grasped"] for own in robots], axis=0),
        }

    def success(self, m: Measures) -> Array:
        """The pot's bottom is more than 10 cm above the table."""
        return m["height"] > SUCCESS_HEIGHT

    def expert(self, m: Measures) -> Array:
        """See `manip.tasks.experts.two_arm_lift_expert`."""
        return lift_pot(m)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: a tool is within 3 cm of its handle; grasp: both robots; lift: success.

        grasp_one: one robot or both.
        """
        robots = [of_robot(m, number) for number in ROBOTS]
        return {
            "near": np.any([own["distance"] < 0.03 for own in robots], axis=0),
            "grasp_one": np.any([own["grasped"] for own in robots], axis=0),
            "grasp": np.all([own["grasped"] for own in robots], axis=0),
            "lift": self.success(m),
        }


def _measure_robot(read: Measures, number: int) -> Measures:
    """What `TwoArmLift.measure` adds for a robot; left, right [N]: its pads touch."""
    to_handle = read[f"handle{number}_pos"] - read["eef_pos"]
    left, right = (
        np.max([read[f"{side}_touch_{bar}"] for bar in BARS], axis=0)
        for side in ("left", "right")
    )
    return {
        "to_handle": to_handle,
        "distance": np.linalg.norm(to_handle, axis=1),
        "left": left,
        "right": right,
        "grasped": (left > 0) & (right > 0),
    }


def _shaped(m: Measures, robots: list[Measures]) -> dict[str, Array]:
    level = 1.0 - ramp(m["pot_tilt"], 0.1, 0.5)
    closed = [own["grasped"] * ramp(own["gripper_closing"], -1, 1) for own in robots]
    return {
        "reach": np.mean([near(own["distance"], 0.2) for own in robots], axis=0),
        "grasp": np.mean(closed, axis=0),
        "lift": level * ramp(m["height"], 0.0, 0.12),
    }


def _stock_terms(m: Measures, robots: list[Measures]) -> dict[str, Array]:
    """robosuite's `TwoArmLift.reward`."""
    success = m["height"] > SUCCESS_HEIGHT
    upright = m["pot_tilt"] <= MOST_TILT
    reach = np.mean([near(own["distance"], 0.1) for own in robots], axis=0)
    return {
        "reach": ~success * reach,
        "grasp": ~success * np.mean([own["grasped"] for own in robots], axis=0),
        "lift": ~success * upright * ramp(m["height"], 0.05, 0.20),
        "success": floats(success & upright),
    }
