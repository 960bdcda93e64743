"""TwoArmPegInHole: one robot puts its peg into the plate of the other. robosuite's
`TwoArmPegInHole`, in which peg and plate are fixed to the hands.

Success: the peg points along the hole to about 18 degrees, the hole's centre is within
6 cm of its axis, and from -12 to 14 cm before its middle (robosuite's test).
Failure: none; an episode ends by its time limit.
Start: arms in their default pose with 0.02 rad noise per joint.
Shaped reward, in [0, 1] per step: 0.3 align + 0.25 aside + 0.2 along + 0.25 done.
    align: the cosine of the angle between the peg and the hole.
    aside: 1 - tanh(5 d) of the distance d [m] of the hole's centre from the peg's axis.
    along: 1 up to 10 cm before or behind the peg's middle, then 1 - tanh(5 d) of the
        distance d [m] beyond that.
    done: 1 on success.
"""

from typing import ClassVar

import numpy as np

from manip.arrays import floats
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import start_qpos
from manip.tasks.experts.two_arm_peg_in_hole_expert import insert_peg
from manip.tasks.rotations import rotation_matrix
from manip.tasks.two_arms import ROBOT_PARTS, observe_robots

Array = np.ndarray

HOLE = 0.1
"""Distance [m] of the hole's centre from the plate's origin, along its x axis
(robosuite/environments/manipulation/two_arm_peg_in_hole.py)."""
MOST_ASIDE = 0.06
"""Distance [m] of the hole's centre from the peg's axis, for success (ibid.)."""
ALONG = (-0.12, 0.14)
"""Distance [m] of the hole's centre along the axis, for success (ibid.)."""
LEAST_COS = 0.95
"""Cosine of the angle between peg and hole, for success (ibid.)."""
DEEP = 0.1
"""Distance [m] along the axis at which the peg is in the hole."""
CENTRE = np.array([0.0, 0.0, 1.1])
"""Point [m] from which the positions of tools and hole are observed."""
GRIPPER = ("gripper_qpos", "gripper_closing")
"""Parts that hands without a gripper lack."""


class TwoArmPegInHole(Task):
    """Insert the peg; see the module's docstring for the numbers."""

    robosuite_name = "TwoArmPegInHole"
    sensors = Sensors(bodies={"peg": "peg_main", "hole": "hole_main"})
    horizon = 100
    milestone_names = ("aligned", "near", "success")
    proprioception = tuple(part for part in ROBOT_PARTS if not part.endswith(GRIPPER))
    weights: ClassVar[Weights] = {
        "shaped": {"align": 0.3, "aside": 0.25, "along": 0.2, "done": 0.25},
        "stock": dict.fromkeys(("reach", "aside", "along", "align", "done"), 0.2),
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the arms' poses."""
        return Start(start_qpos(scene, streams))

    def measure(self, read: Measures) -> Measures:
        """Add peg_axis, hole_axis [N, 3]; to_hole [N, 3] m from the peg's middle.

        along [N] m: of to_hole along the peg's axis; aside [N] m: the rest of it; cos
        [N]: of the angle between the axes, at most 90 degrees.
        """
        peg, hole = (rotation_matrix(read[f"{name}_quat"]) for name in ("peg", "hole"))
        peg_axis, hole_axis = peg[:, 2::3], hole[:, 2::3]
        to_hole = read["hole_pos"] + HOLE * hole[:, ::3] - read["peg_pos"]
        along = (to_hole * peg_axis).sum(axis=1)
        return {
            **read,
            "peg_axis": peg_axis,
            "hole_axis": hole_axis,
            "to_hole": to_hole,
            "along": along,
            "aside": np.linalg.norm(to_hole - along[:, None] * peg_axis, axis=1),
            "cos": np.abs((peg_axis * hole_axis).sum(axis=1)),
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The robots, the axes, and the hole: its position, and that from the peg."""
        robots = observe_robots(m, CENTRE)
        return {
            **{name: robots[name] for name in self.proprioception},
            "peg_axis": m["peg_axis"],
            "hole_axis": m["hole_axis"],
            "hole_pos": 4.0 * (m["peg_pos"] + m["to_hole"] - CENTRE),
            "to_hole": 5.0 * np.clip(m["to_hole"], -1.0, 1.0),
            "relative": np.column_stack(
                [5.0 * np.clip(m[name], -1.0, 1.0) for name in ("along", "aside")]
            ),
            "cos": m["cos"][:, None],
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        done = floats(self.success(m))
        if reward == "stock":
            apart = np.linalg.norm(m["peg_pos"] - m["hole_pos"], axis=1)
            return {
                "reach": near(apart, 1.0),
                "aside": near(m["aside"], 1.0),
                "along": near(np.abs(m["along"]), 1.0),
                "align": m["cos"],
                "done": done,
            }
        beyond = np.maximum(np.abs(m["along"]) - DEEP, 0.0)
        return {
            "align": m["cos"],
            "aside": near(m["aside"], 0.2),
            "along": near(beyond, 0.2),
            "done": done,
        }

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """Motion of the first hand; along and aside [N] m; angle [N] rad."""
        named = super().visible_measures(m)
        del named["closing"]
        angle = np.arccos(np.clip(m["cos"], 0.0, 1.0))
        return {**named, "along": m["along"], "aside": m["aside"], "angle": angle}

    def success(self, m: Measures) -> Array:
        """robosuite's test; see the module's docstring."""
        placed = (m["along"] >= ALONG[0]) & (m["along"] <= ALONG[1])
        return (m["aside"] < MOST_ASIDE) & placed & (m["cos"] > LEAST_COS)

    def expert(self, m: Measures) -> Array:
        """See `manip.tasks.experts.two_arm_peg_in_hole_expert`."""
        return insert_peg(m)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """aligned: to 18 degrees; near: aligned, within 6 cm of the axis; success."""
        aligned = m["cos"] > LEAST_COS
        return {
            "aligned": aligned,
            "near": aligned & (m["aside"] < MOST_ASIDE),
            "success": self.success(m),
        }
