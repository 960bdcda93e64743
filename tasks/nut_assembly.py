"""Put a nut over its peg. robosuite's `NutAssemblySquare` and `NutAssemblyRound`.

Success: the nut's centre is within 3 cm of the peg along both horizontal axes, less
    than 5 cm above the table, and more than 4.24 cm from the tool. (This is robosuite's
    test. A nut that is still grasped by its handle passes it.)
Failure: none; an episode ends by its time limit.
Start: the nut at x in [-11.5, -11] cm, |y| in [11, 22.5] cm on its peg's side, any yaw,
    dropped from 6 cm; the other nut falls 10 m beside the table; arm in its default
    pose with 0.02 rad noise per joint, gripper half open.
Shaped reward, in [0, 1] per step: see `nut_assembly_rewards`.
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Waypoint, Weights
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks import nut_assembly_rewards as rewards
from manip.tasks.arm import ARM_PARTS, TOOL_PARTS, observe_arm_and_tool, start_qpos
from manip.tasks.experts.nut_assembly_expert import assemble_nut
from manip.tasks.nut_assembly_measures import (
    BESIDE,
    REST,
    TOP,
    measure_nut,
    on_peg_and_clear,
)
from manip.tasks.nut_assembly_waypoints import NAMES, Nut, place_nut, rest_on_peg
from manip.tasks.object_measures import object_measures
from manip.tasks.object_task import ObjectTask
from manip.tasks.offsets import coarse, fine
from manip.tasks.placement import PARKED
from manip.tasks.rotations import cos_sin, yaw_angle, yaw_quaternion

Array = np.ndarray

CENTRE = np.array([0.05, 0.0, 0.95])
"""Origin [m] of the observed tool position."""
START_LOW, START_HIGH = np.array([-0.115, 0.11, 0.89]), np.array([-0.11, 0.225, 0.89])
"""Corners [m] of the box in which the square nut's centre starts. The round one's is
mirrored in y (robosuite/environments/manipulation/nut_assembly.py)."""


class OneNut(ObjectTask):
    """Put a nut over its peg; see the module's docstring for the numbers.

    Attributes:
        other: body of the nut that is parked.
        side: 1 where the nut starts at positive y, else -1.
        peg_radius: half width [m] of the peg.
        play: largest distance [m] of the nut's centre from the peg's axis at which it
            fits over the peg.
        handle: distance [m] of the handle's centre from the nut's.
        fits: number of yaws in which it fits over its peg; 0 for any.
    """

    other: ClassVar[str]
    side: ClassVar[int]
    peg_radius: ClassVar[float]
    play: ClassVar[float]
    handle: ClassVar[float]
    fits: ClassVar[int]

    proprioception = (*ARM_PARTS, *TOOL_PARTS)
    horizon = 150
    milestone_names = ("near", "grasp", "lift", "over", "on_peg", "success")
    waypoint_names = NAMES
    weights: ClassVar[Weights] = rewards.WEIGHTS

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the nut's pose; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        qpos[:, scene.free_qpos(self.body)] = self.sample_pose(streams)
        qpos[:, scene.free_qpos(self.other)] = PARKED
        return Start(qpos)

    def sample_pose(self, streams: EpisodeStreams) -> Array:
        """[n, 7]: the qpos with which the nut starts."""
        place = streams.uniform(START_LOW, START_HIGH, 3) * [1, self.side, 1]
        turn = yaw_quaternion(streams.uniform(0, 2 * np.pi, 1)[:, 0])
        return np.concatenate([place, turn], axis=1)

    @property
    def _nut(self) -> Nut:
        return Nut(self.side, self.play, self.handle, self.fits)

    def place_in_hand(
        self, milestone: str, scene: Scene, streams: EpisodeStreams, start: Start
    ) -> Waypoint:
        """See `manip.tasks.nut_assembly_waypoints`."""
        body = scene.free_qpos(self.body)
        return place_nut(self._nut, milestone, streams, start, body)

    def sample_rest(self, streams: EpisodeStreams) -> Array:
        """[n, 7]: qpos of the nut that lies around its peg."""
        return rest_on_peg(self._nut, streams)

    def measure(self, read: Measures) -> Measures:
        """As `measure_nut`, and whether the nut is on its peg, or fits over it.

        threaded [N] bool: the peg passes through the nut; fit [N] in [0, 1]: how well
        the nut is turned for its peg; fits [N] bool: it may go down over the peg.
        """
        m = measure_nut(read)
        fit = self.fit(m["nut_mat"])
        threaded = (m["height"] < TOP) & (m["aside"] < self.peg_radius)
        fits = (m["aside"] < self.play) & (fit > 0.9)
        return {**m, "threaded": threaded, "fit": fit, "fits": fits}

    def fit(self, nut_mat: Array) -> Array:
        """[N] in [0, 1]: how well a nut of rotation [N, 9] is turned for its peg."""
        return np.ones(len(nut_mat))

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and the tool, then the nut and its peg, coarse and fine."""
        above = np.stack([m["height"] - REST, m["height"] - TOP - 0.01], axis=1)
        return {
            **observe_arm_and_tool(m, CENTRE),
            "to_handle": coarse(m["to_handle"]),
            "to_handle_fine": fine(m["to_handle"]),
            "handle_turn": cos_sin(2.0 * m["handle_turn"]),
            "to_peg": 5.0 * np.clip(m["to_peg"], -0.5, 0.5),
            "to_peg_fine": fine(m["to_peg"][:, :2]),
            "above_fine": fine(above),
            "nut_yaw": cos_sin(yaw_angle(m["nut_mat"])),
            "upright": m["nut_mat"][:, 6:],
            "nut_linvel": m["nut_linvel"],
            "nut_angvel": 0.2 * m["nut_angvel"],
            "touch": np.stack([m["left_touch"], m["right_touch"]], axis=1),
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        return rewards.TERMS[reward](m, self.success(m))

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's and the nut's (see `object_measures`); aside [N] m from its peg.

        object_distance is to the handle; object_height is that of the nut's centre in
        the world.
        """
        return {
            **super().visible_measures(m),
            **object_measures(m, "nut"),
            "aside": m["aside"],
        }

    def success(self, m: Measures) -> Array:
        """The nut is low, at its peg, and its centre away from the tool."""
        return on_peg_and_clear(m)

    def expert(self, m: Measures) -> Array:
        """See `manip.tasks.experts.nut_assembly_expert`."""
        return assemble_nut(m)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 5 cm of the handle; lift: by 3 cm; over: above the peg.

        grasp: a firm grasp; on_peg: the peg passes through the nut.
        """
        lifted = m["firm_grasp"] & (m["height"] > REST + 0.03)
        return {
            "near": m["distance"] < 0.05,
            "grasp": m["firm_grasp"],
            "lift": lifted,
            "over": lifted & (m["height"] > TOP) & (m["aside"] < BESIDE),
            "on_peg": m["threaded"],
            "success": self.success(m),
        }


def nut_sensors(nut: str, peg: str, **more: str) -> Sensors:
    """What is read of a nut and its peg, and of more bodies."""
    return Sensors(
        bodies={"nut": f"{nut}_main", **more, "peg": peg},
        sites={"handle": f"{nut}_handle_site"},
        touches={
            "left_touch": ("left_fingerpad", f"{nut}_main"),
            "right_touch": ("right_fingerpad", f"{nut}_main"),
        },
    )


class NutAssemblyRound(OneNut):
    """The round nut over the round peg, 4 cm wide."""

    robosuite_name = "NutAssemblyRound"
    sensors = nut_sensors("RoundNut", "peg2", other="SquareNut_main")
    body, other, side = "RoundNut_main", "SquareNut_main", -1
    peg_radius, play, handle, fits = 0.02, 0.01, 0.06, 0


class NutAssemblySquare(OneNut):
    """The square nut over the square peg, 3.2 cm wide. It fits in four yaws."""

    robosuite_name = "NutAssemblySquare"
    sensors = nut_sensors("SquareNut", "peg1", other="RoundNut_main")
    body, other, side = "SquareNut_main", "RoundNut_main", 1
    peg_radius, play, handle, fits = 0.016, 0.006, 0.054, 4

    def observe(self, m: Measures) -> dict[str, Array]:
        """As for any nut, and its yaw relative to its peg."""
        return {
            **super().observe(m),
            "peg_turn": cos_sin(4.0 * yaw_angle(m["nut_mat"])),
        }

    def fit(self, nut_mat: Array) -> Array:
        """[N] in [0, 1]: 1 where the nut's sides are parallel to the peg's."""
        return (1 + np.cos(4 * yaw_angle(nut_mat))) / 2
