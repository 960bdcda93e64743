"""Wipe: clean a line of dirt off a table. robosuite's `Wipe`, with its WipingGripper.

Success: all 100 markers are wiped: each was once, while the wiper touched something,
    less than 2 cm above the wiper's face and within its edges (robosuite's test).
Failure: a link of the arm touches something, or a joint is within 0.1 rad of its limit.
Start: markers 5 mm apart along a random walk: its start uniform on the middle 60 % of
    the table, its direction uniform, turned by N(0, 0.5) rad at 30 % of the markers and
    as often as it would leave that part; arm in its default pose with 0.02 rad noise.
Shaped reward, in [0, 1] a step: 0.15 near + 0.05 touch + 0.6 wiped + 0.2 clean, where
    near is 1 - tanh(5 d) of the distance d [m] from the wiper to the nearest marker
    left, touch is paid while the wiper touches anything with at most 60 N, wiped is the
    share of wiped markers, and clean is success; near and touch are then paid in full.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import observe_arm, start_qpos
from manip.tasks.dirt import MARKERS, below, left, walk
from manip.tasks.experts.wipe import wipe
from manip.tasks.objects import turns, yaw

Array = np.ndarray

TABLE = np.array([0.15, 0.0, 0.875])
"""Centre of the table, from which markers are placed [m] (ibid.)."""
TOP = 0.025
"""Height [m] of the table's top above its centre (ibid.)."""
MARGIN = 0.1
"""Angle [rad] from a joint's limit at which an episode fails (robots/robot.py)."""
HARD = 60.0
"""Force [N] from which robosuite pays a penalty (wipe.py)."""
SCALE = 1000 / (100 * 50 + 1000 * (0.01 + 25.5))
"""robosuite's factor, with its horizon of 1000 steps (ibid.)."""
CENTRE = np.array([0.1, 0.0, 1.0])
"""Origin [m] of the tool's place in observations."""


class Wipe(Task):
    """Wipe all markers off; see the module's docstring for the numbers."""

    robosuite_name = "Wipe"
    sensors = Sensors(
        sites={
            f"corner{i}": f"gripper0_right_wiping_corner{i}_site" for i in (1, 2, 3, 4)
        },
        touches={"arm_touch": ("arm", "world")},
        counts={"contacts": ("gripper0_right_wiping_gripper", "world")},
        forces={"force": "gripper0_right_ft_frame"},
        fields={f"marker{i}": ("body_pos", f"contact{i}_main") for i in range(MARKERS)},
        memory={"was_wiped": MARKERS, "last_force": 3, "bias": 3},
    )
    horizon = 200
    milestone_names = ("near", "touch", "begun", "half", "clean")
    weights: ClassVar[Weights] = {
        "shaped": {"near": 0.15, "touch": 0.05, "wiped": 0.6, "clean": 0.2},
        "stock": {
            "unsafe": -10 * SCALE,
            "wiped": 50 * SCALE,
            "near": 5 * SCALE,
            "touch": 0.01 * SCALE,
            "press": 0.01 * SCALE,
            "force": -0.05 * SCALE,
            "clean": 50 * 0.51 * SCALE,
        },
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Lay the markers out; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        heights = np.full((len(streams), 1), TOP)
        places = walk(streams)
        fields = {f"marker{i}": np.hstack([places[i], heights]) for i in range(MARKERS)}
        return Start(qpos, fields)

    def measure(self, read: Measures) -> Measures:
        """Add where the markers left are, which are wiped, and what is touched.

        wiped [N, 100], fresh [N] how many of them in this step, share [N] of all;
        nearest, centroid, farthest [N, 3] m, from the tool to markers left (zeros if
        none is), distance [N] m to the nearest; unsafe [N], see Failure.
        """
        marks = TABLE + np.stack([read[f"marker{i}"] for i in range(MARKERS)], axis=1)
        room = np.minimum(
            read["joint_pos"] - read["joint_low"],
            read["joint_high"] - read["joint_pos"],
        )
        unsafe = (read["arm_touch"] > 0) | (room <= MARGIN).any(axis=1)
        now = below(marks, read) & ((read["contacts"] > 0) & ~unsafe)[:, None]
        wiped = (read["was_wiped"] > 0) | now
        places = left(marks - read["eef_pos"][:, None], ~wiped)
        return {
            **read,
            **places,
            "wiped": wiped,
            "fresh": (wiped & (read["was_wiped"] == 0)).sum(axis=1),
            "share": wiped.mean(axis=1),
            "distance": np.linalg.norm(places["nearest"], axis=1),
            "unsafe": unsafe,
        }

    def update_memory(self, m: Measures) -> Mapping[str, Array]:
        """What is wiped, the force, and that of the first step, robosuite's bias."""
        first = (m["last_force"] != 0).any(axis=1) & (m["bias"] == 0).all(axis=1)
        return {
            "was_wiped": m["wiped"].astype(float),
            "last_force": m["force"],
            "bias": np.where(first[:, None], m["force"], m["bias"]),
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and how it is turned, what it touches, and the markers left."""
        parts = observe_arm(m, CENTRE)
        for none in "gripper_qpos", "gripper_closing":
            del parts[none]
        return {
            **parts,
            "tool_yaw": turns(yaw(m["eef_mat"])),
            "tool_tilt": 3.0 * m["eef_mat"][:, [2, 5]],
            "height": 50.0 * np.clip(m["eef_pos"][:, 2:] - TABLE[2] - TOP, -0.02, 0.02),
            "force": np.clip(m["force"] / 30.0, -3, 3),
            "contacts": m["contacts"][:, None] / 30.0,
            "nearest": 10.0 * np.clip(m["nearest"], -0.3, 0.3),
            "nearest_fine": 50.0 * np.clip(m["nearest"], -0.04, 0.04),
            "centroid": 5.0 * np.clip(m["centroid"], -1, 1),
            "farthest": 5.0 * np.clip(m["farthest"], -1, 1),
            "share": m["share"][:, None],
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        if reward == "stock":
            return self._stock_terms(m)
        done = self.success(m)
        soft = (m["contacts"] > 0) & (np.linalg.norm(m["force"], axis=1) <= HARD)
        return {
            "near": np.maximum(done, near(m["distance"], 0.2)),
            "touch": (done | soft).astype(float),
            "wiped": m["share"],
            "clean": done.astype(float),
        }

    def _stock_terms(self, m: Measures) -> dict[str, Array]:
        """Nothing but a penalty where it is unsafe; forces are those a step ago."""
        safe, done = ~m["unsafe"], self.success(m)
        force = np.linalg.norm(m["last_force"], axis=1)
        change = np.linalg.norm(m["force"] - m["bias"], axis=1)
        hard = force > HARD
        presses = ~hard & (force > 0.5) & (m["contacts"] > 1)
        press = 1 + force + 10 * (m["contacts"] > 50)
        gap = np.linalg.norm(m["centroid"], axis=1)
        return {
            "unsafe": m["unsafe"].astype(float),
            "wiped": safe * m["fresh"],
            "near": safe * ~done * near(gap, 0.2),
            "touch": safe * (m["contacts"] > 0) * (change > 1.0),
            "press": safe * presses * press,
            "force": safe * hard * force,
            "clean": (safe & done).astype(float),
        }

    def success(self, m: Measures) -> Array:
        """All markers are wiped."""
        return m["share"] == 1

    def failure(self, m: Measures) -> Array:
        """A link touches something, or a joint is near its limit."""
        return m["unsafe"]

    def expert(self, m: Measures) -> Array:
        """As `manip.tasks.experts.wipe`."""
        return wipe(m)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: within 5 cm of a marker; touch; a tenth, half and all are wiped."""
        return {
            "near": m["distance"] < 0.05,
            "touch": m["contacts"] > 0,
            "begun": m["share"] >= 0.1,
            "half": m["share"] >= 0.5,
            "clean": self.success(m),
        }
