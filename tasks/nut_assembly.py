"""NutAssembly: put a nut over its peg. robosuite's `NutAssemblySquare` and `...Round`.

Success: the nut's centre is within 3 cm of the peg along both horizontal axes, less
    than 5 cm above the table, and more than 4.24 cm from the tool (robosuite's test,
    which a nut that is still held by its handle passes).
Failure: none; an episode ends by time.
Start: the nut at x in [-11.5, -11] cm, |y| in [11, 22.5] cm on its peg's side, any yaw,
    dropped from 6 cm; the other nut falls 10 m beside the table; arm in its default
    pose with 0.02 rad noise a joint, gripper half open.
Shaped reward, in [0, 1] a step: 0.1 reach + 0.05 turn + 0.15 grasp + 0.15 lift
    + 0.25 over + 0.05 thread + 0.15 down + 0.05 release + 0.05 stay. Reach is
    1 - tanh(5 d) of the distance d [m] by which the tool is farther than 1.5 cm from
    the handle, and half of that with a gripper closed around nothing; turn rises as the
    fingers come to lie across the handle, within 10 cm of it; grasp rises from 0 to 1
    as the gripper is told to close, the more across the handle the more; half of lift
    is paid over the first 4 cm, half over the way up to 2 cm above the peg; over is
    lift times the nearness of the nut to the peg, from afar and within 3 cm, the latter
    times how well a square nut is turned; down rises as the nut sinks along the peg,
    once it clears it. All but reach and turn are paid only while both finger pads touch
    the nut and the tool is within 2 cm of the handle. Once the nut is on the peg, what
    comes before `thread` is paid in full, and release grows with the opening of the
    gripper. A nut held over its peg earns at most 0.73, on the peg at least 0.78, and
    with success 1.
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near, ramp
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import observe_arm, ready, start_qpos, yaw_quaternion
from manip.tasks.experts.nut_assembly import nut_assembly
from manip.tasks.objects import PARKED, rotation, turns, yaw

Array = np.ndarray

TABLE = 0.82
"""Height [m] that robosuite counts from (environments/manipulation/nut_assembly.py)."""
CENTRE = np.array([0.05, 0.0, 0.95])
"""Origin [m] of the tool's place in observations."""
START_LOW, START_HIGH = np.array([-0.115, 0.11, 0.89]), np.array([-0.11, 0.225, 0.89])
"""Where a nut's centre starts [m], mirrored for the round one (ibid.)."""
REST = 0.83
"""Height [m] of the centre of a nut that lies on the table."""
TOP = 0.95
"""Height [m] of the pegs' tops (models/assets/arenas/pegs_arena.xml)."""
BESIDE, LOW, CLEAR = 0.03, TABLE + 0.05, 0.1 * np.arctanh(0.4)
"""Success [m]: nut beside the peg, its height, its centre from the tool (ibid.)."""
AROUND = 0.02
"""Distance [m] of the tool from the handle, below which it is around it."""
AT = 0.015
"""Distance [m] of the tool from the handle, below which coming nearer pays no more."""
UP = REST + 0.04
"""Height [m] over the way to which lifting pays the most."""
HOVER = TOP + 0.02
"""Height [m] from which a nut's lower side clears the peg by 1 cm."""


class NutAssembly(Task):
    """Put a nut over its peg; see the module's docstring for the numbers.

    Attributes:
        nut, other: bodies of the nut to move, and of the one out of the way.
        side: 1 where the nut starts at positive y, else -1.
        peg_radius: half width [m] of the peg.
        play: how far [m] the nut's centre may be from the axis of its peg.
    """

    nut: ClassVar[str]
    other: ClassVar[str]
    side: ClassVar[int]
    peg_radius: ClassVar[float]
    play: ClassVar[float]

    horizon = 150
    milestone_names = ("near", "grasp", "lift", "over", "on_peg", "success")
    weights: ClassVar[Weights] = {
        "shaped": {
            "reach": 0.1,
            "turn": 0.05,
            "grasp": 0.15,
            "lift": 0.15,
            "over": 0.25,
            "thread": 0.05,
            "down": 0.15,
            "release": 0.05,
            "stay": 0.05,
        },
        "stock": {"staged": 0.7, "success": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Place the nuts; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        place = streams.uniform(START_LOW, START_HIGH, 3) * [1, self.side, 1]
        turn = yaw_quaternion(streams.uniform(0, 2 * np.pi, 1)[:, 0])
        qpos[:, scene.free_qpos(self.nut)] = np.concatenate([place, turn], axis=1)
        qpos[:, scene.free_qpos(self.other)] = PARKED
        return Start(qpos)

    def measure(self, read: Measures) -> Measures:
        """Add offsets and turns between tool, handle, nut and peg; what is held.

        to_handle [N, 3] m from the tool, distance [N] m; to_peg [N, 3] m from the
        nut's centre to that of the peg, aside [N] m its horizontal part; nut_mat
        [N, 9]; handle_turn, peg_turn [N] rad by which the tool and the nut must yaw;
        grasped [N] is robosuite's test, held [N] asks that the tool is around the
        handle, too; threaded [N]: the peg passes through the nut.
        """
        to_handle = read["handle_pos"] - read["eef_pos"]
        to_peg = read["peg_pos"] - read["nut_pos"]
        distance, aside = np.linalg.norm(to_handle, axis=1), np.hypot(*to_peg[:, :2].T)
        grasped = (read["left_touch"] > 0) & (read["right_touch"] > 0)
        nut_mat = rotation(read["nut_quat"])
        return {
            **read,
            "to_handle": to_handle,
            "distance": distance,
            "to_peg": to_peg,
            "aside": aside,
            "height": read["nut_pos"][:, 2],
            "nut_mat": nut_mat,
            "handle_turn": yaw(nut_mat) + np.pi / 2 - yaw(read["eef_mat"]),
            "grasped": grasped,
            "held": grasped & (distance < AROUND),
            "threaded": (read["nut_pos"][:, 2] < TOP) & (aside < self.peg_radius),
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and how it is turned, then the nut and its peg, coarse and fine."""
        above = np.stack([m["height"] - REST, m["height"] - TOP - 0.01], axis=1)
        return {
            **observe_arm(m, CENTRE),
            "tool_yaw": turns(yaw(m["eef_mat"])),
            "tool_tilt": 3.0 * m["eef_mat"][:, [2, 5]],
            "to_handle": 10.0 * np.clip(m["to_handle"], -0.3, 0.3),
            "to_handle_fine": 50.0 * np.clip(m["to_handle"], -0.02, 0.02),
            "handle_turn": turns(2.0 * m["handle_turn"]),
            "to_peg": 5.0 * np.clip(m["to_peg"], -0.5, 0.5),
            "to_peg_fine": 50.0 * np.clip(m["to_peg"][:, :2], -0.02, 0.02),
            "above_fine": 50.0 * np.clip(above, -0.02, 0.02),
            "nut_yaw": turns(yaw(m["nut_mat"])),
            "upright": m["nut_mat"][:, 6:],
            "nut_linvel": m["nut_linvel"],
            "nut_angvel": 0.2 * m["nut_angvel"],
            "touch": np.stack([m["left_touch"], m["right_touch"]], axis=1),
        }

    def fit(self, m: Measures) -> Array:
        """[N] in [0, 1]: how well the nut is turned for its peg."""
        return np.ones(len(m["aside"]))

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        if reward == "stock":
            return self._stock_terms(m)
        done, on = self.success(m), m["threaded"] | self.success(m)
        clears = (m["aside"] < self.play) & (self.fit(m) > 0.9)
        up = (ramp(m["height"], REST, UP) + ramp(m["height"], REST, HOVER)) / 2
        lift = m["held"] * np.maximum(up, clears)
        beside = 0.6 * (1 - ramp(m["aside"], 0.0, 0.5))
        beside += 0.4 * near(m["aside"], 0.03) * self.fit(m)
        down = (on | (m["held"] & clears)) * ramp(-m["height"], -HOVER, -LOW)
        across = (1 + np.cos(2 * m["handle_turn"])) / 2
        opening = ramp(-m["gripper_closing"], -1.0, 1.0)
        reach = ready(m) * near(np.maximum(m["distance"] - AT, 0.0), 0.2)
        return {
            "reach": np.maximum(on, reach),
            "turn": np.maximum(on, across * near(m["distance"], 0.1)),
            "grasp": np.maximum(on, m["held"] * across * (1 - opening)),
            "lift": np.maximum(on, lift),
            "over": np.maximum(on, lift * beside),
            "thread": on.astype(float),
            "down": np.maximum(done, down),
            "release": np.maximum(done, on * opening),
            "stay": done.astype(float),
        }

    def _stock_terms(self, m: Measures) -> dict[str, Array]:
        """The largest of robosuite's milestones; to lift, it takes the higher nut."""
        highest = np.maximum(m["height"], m["other_pos"][:, 2])
        below = np.maximum(TABLE - 0.025 + 0.2 - highest, 0.0)
        lift = m["grasped"] * (0.35 + 0.15 * near(below, 1 / 15))
        over = lift + 0.2 * near(m["aside"], 0.1)
        staged = np.maximum(0.1 * near(m["distance"], 0.1), over)
        return {
            "staged": ~self.success(m) * staged / 0.7,
            "success": self.success(m).astype(float),
        }

    def success(self, m: Measures) -> Array:
        """The nut is low, at its peg, and its centre clear of the tool."""
        beside = (np.abs(m["to_peg"][:, :2]) < BESIDE).all(axis=1)
        clear = np.linalg.norm(m["nut_pos"] - m["eef_pos"], axis=1) > CLEAR
        return beside & (m["height"] < LOW) & clear

    def expert(self, m: Measures) -> Array:
        """As `manip.tasks.experts.nut_assembly`."""
        return nut_assembly(m)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 5 cm of the handle; lift: by 3 cm; over: within 3 cm."""
        lifted = m["held"] & (m["height"] > REST + 0.03)
        return {
            "near": m["distance"] < 0.05,
            "grasp": m["held"],
            "lift": lifted,
            "over": lifted & (m["height"] > TOP) & (m["aside"] < BESIDE),
            "on_peg": m["threaded"],
            "success": self.success(m),
        }


def _sensors(nut: str, other: str, peg: str) -> Sensors:
    return Sensors(
        bodies={"nut": f"{nut}_main", "other": f"{other}_main", "peg": peg},
        sites={"handle": f"{nut}_handle_site"},
        touches={
            "left_touch": ("left_fingerpad", f"{nut}_main"),
            "right_touch": ("right_fingerpad", f"{nut}_main"),
        },
    )


class NutAssemblyRound(NutAssembly):
    """The round nut over the round peg, 4 cm wide."""

    robosuite_name = "NutAssemblyRound"
    sensors = _sensors("RoundNut", "SquareNut", "peg2")
    nut, other, side = "RoundNut_main", "SquareNut_main", -1
    peg_radius, play = 0.02, 0.01


class NutAssemblySquare(NutAssembly):
    """The square nut over the square peg, 3.2 cm wide: it fits best in four turns."""

    robosuite_name = "NutAssemblySquare"
    sensors = _sensors("SquareNut", "RoundNut", "peg1")
    nut, other, side = "SquareNut_main", "RoundNut_main", 1
    peg_radius, play = 0.016, 0.006

    def observe(self, m: Measures) -> dict[str, Array]:
        """As for any nut, and how it is turned to its peg."""
        return {**super().observe(m), "peg_turn": turns(4.0 * yaw(m["nut_mat"]))}

    def fit(self, m: Measures) -> Array:
        """[N] in [0, 1]: 1 where the nut's sides lie along the peg's."""
        return (1 + np.cos(4 * yaw(m["nut_mat"]))) / 2
