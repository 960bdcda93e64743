"""Wipe: clean a line of dirt off a table. robosuite's `Wipe`, with its WipingGripper.

Success: all 100 markers are wiped. A marker is wiped once it is less than 2 cm above
    the wiper's face and within its edges while the wiper touches something
    (robosuite's test).
Failure: a link of the arm touches something, or a joint is within 0.1 rad of its limit.
Start: markers 5 mm apart along a random walk. It starts uniformly on the middle 60 % of
    the table, in a uniform direction. It turns by N(0, 0.5) rad at 30 % of the markers,
    and as often as it would leave that part of the table. Arm in its default pose with
    0.02 rad noise per joint.
Shaped reward, in [0, 1] per step: see `wipe_rewards`.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks import wipe_rewards as rewards
from manip.tasks.arm import (
    TOOL_PARTS,
    near_joint_limit,
    observe_arm_and_tool,
    start_qpos,
)
from manip.tasks.experts.wipe_expert import wipe_table
from manip.tasks.offsets import coarse, fine
from manip.tasks.wipe_markers import (
    MARKERS,
    remaining_markers,
    sample_markers,
    under_wiper,
)

Array = np.ndarray

TABLE = np.array([0.15, 0.0, 0.875])
"""Centre of the table [m] (robosuite/environments/manipulation/wipe.py)."""
TOP = 0.025
"""Height [m] of the table's top above its centre (ibid.)."""
JOINT_MARGIN = 0.1
"""Angle [rad] from a joint's limit at which an episode fails (robots/robot.py)."""
CENTRE = np.array([0.1, 0.0, 1.0])
"""Origin [m] of the observed tool position."""
CORNERS = {f"corner{i}": f"gripper0_right_wiping_corner{i}_site" for i in (1, 2, 3, 4)}
"""Sites at the corners of the wiper's face."""


class Wipe(Task):
    """Wipe all markers; see the module's docstring for the numbers."""

    robosuite_name = "Wipe"
    proprioception = (
        "joint_pos",
        "joint_vel",
        "eef_pos",
        *TOOL_PARTS,
        "height",
        "force",
    )
    sensors = Sensors(
        sites=CORNERS,
        touches={"arm_touch": ("arm", "world")},
        counts={"contacts": ("gripper0_right_wiping_gripper", "world")},
        forces={"force": "gripper0_right_ft_frame"},
        fields={f"marker{i}": ("body_pos", f"contact{i}_main") for i in range(MARKERS)},
        memory={"was_wiped": MARKERS, "last_force": 3, "bias": 3},
    )
    horizon = 200
    milestone_names = ("near", "touch", "begun", "half", "clean")
    weights: ClassVar[Weights] = rewards.WEIGHTS

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the markers' positions; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        heights = np.full((len(streams), 1), TOP)
        places = sample_markers(streams)
        fields = {f"marker{i}": np.hstack([places[i], heights]) for i in range(MARKERS)}
        return Start(qpos, fields)

    def measure(self, read: Measures) -> Measures:
        """Add which markers are wiped, where the others are, and what is unsafe.

        wiped [N, 100] bool; fresh [N], the number wiped in this step; share [N], the
        wiped fraction; nearest, centroid, farthest [N, 3] m, from the tool to the dirty
        markers (zeros if there is none); distance [N] m to the nearest; unsafe [N]
        bool, see Failure.
        """
        markers = TABLE + np.stack([read[f"marker{i}"] for i in range(MARKERS)], axis=1)
        unsafe = (read["arm_touch"] > 0) | near_joint_limit(read, JOINT_MARGIN)
        active = (read["contacts"] > 0) & ~unsafe
        wiped = (read["was_wiped"] > 0) | (under_wiper(markers, read) & active[:, None])
        remaining = remaining_markers(markers - read["eef_pos"][:, None], ~wiped)
        return {
            **read,
            **remaining,
            "wiped": wiped,
            "fresh": (wiped & (read["was_wiped"] == 0)).sum(axis=1),
            "share": wiped.mean(axis=1),
            "distance": np.linalg.norm(remaining["nearest"], axis=1),
            "unsafe": unsafe,
        }

    def update_memory(self, m: Measures) -> Mapping[str, Array]:
        """Store what is wiped, the force, and the first force, robosuite's bias."""
        first = (m["last_force"] != 0).any(axis=1) & (m["bias"] == 0).all(axis=1)
        return {
            "was_wiped": m["wiped"].astype(float),
            "last_force": m["force"],
            "bias": np.where(first[:, None], m["force"], m["bias"]),
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and the tool, force and contacts, and the dirty markers."""
        parts = observe_arm_and_tool(m, CENTRE)
        for name in "gripper_qpos", "gripper_closing":  # the wiper has no fingers
            del parts[name]
        return {
            **parts,
            "height": fine(m["eef_pos"][:, 2:] - TABLE[2] - TOP),
            "force": np.clip(m["force"] / 30.0, -3, 3),
            "contacts": m["contacts"][:, None] / 30.0,
            "nearest": coarse(m["nearest"]),
            "nearest_fine": 50.0 * np.clip(m["nearest"], -0.04, 0.04),
            "centroid": 5.0 * np.clip(m["centroid"], -1, 1),
            "farthest": 5.0 * np.clip(m["farthest"], -1, 1),
            "share": m["share"][:, None],
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        return rewards.TERMS[reward](m, self.success(m))

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's; dirt_distance [N] m to the nearest marker; wiped [N], a share."""
        measures = super().visible_measures(m)
        del measures["closing"]  # the wiper has no fingers
        return {**measures, "dirt_distance": m["distance"], "wiped": m["share"]}

    def success(self, m: Measures) -> Array:
        """All markers are wiped."""
        return m["share"] == 1

    def failure(self, m: Measures) -> Array:
        """A link touches something, or a joint is near its limit."""
        return m["unsafe"]

    def expert(self, m: Measures) -> Array:
        """See `manip.tasks.experts.wipe_expert`."""
        return wipe_table(m)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: within 5 cm of a marker; begun, half, clean: 10, 50, 100 % are wiped.

        touch: the wiper touches something.
        """
        return {
            "near": m["distance"] < 0.05,
            "touch": m["contacts"] > 0,
            "begun": m["share"] >= 0.1,
            "half": m["share"] >= 0.5,
            "clean": self.success(m),
        }
