"""Stack: put the small cube A on the big cube B. robosuite's `Stack`.

Success: A touches B, its centre is more than 4 cm above the table, and the finger pads
    do not both touch A (robosuite's test).
Failure: none; an episode ends by its time limit.
Start: both cubes' centres uniform within +-8 cm of the table's, their circles apart,
    any yaw, 1 cm above the table; arm in its default pose with 0.02 rad noise per
    joint, gripper half open. A's edge is 4 cm, B's 5 cm.
Shaped reward, in [0, 1] per step: see `stack_rewards`.
"""

from typing import ClassVar

import numpy as np

from manip.arrays import constant, floats, namespace
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Waypoint, Weights
from manip.rewards.kernels import ramp
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks import stack_rewards as rewards
from manip.tasks.arm import (
    ARM_PARTS,
    TOOL_PARTS,
    both_pads_touch,
    observe_arm_and_tool,
    start_qpos,
)
from manip.tasks.experts.stack_expert import stack_cubes
from manip.tasks.object_measures import object_measures
from manip.tasks.offsets import coarse, fine
from manip.tasks.placement import poses_with_any_yaw, scatter
from manip.tasks.rotations import cos_sin, rotation_matrix, yaw_angle
from manip.tasks.stack_rewards import HALF, STACKED, SUCCESS_HEIGHT
from manip.tasks.stack_waypoints import NAMES, place_cubes

Array = np.ndarray

TABLE = np.array([0.0, 0.0, 0.8])
"""Centre of the table top [m] (robosuite/environments/manipulation/stack.py)."""
CENTRE = TABLE + np.array([0.0, 0.0, 0.15])
"""Origin [m] of the observed tool position."""
SPREAD = np.array([0.08, 0.08])
"""Half width [m] of the square in which the cubes start (ibid.)."""
DROP = 0.01
"""Height [m] above the table from which the cubes are dropped (ibid.)."""
GRASP_FAR = 0.025
"""Distance [m] of the tool from A's centre at which grasp_quality is 0."""
GRASP_NEAR = 0.015
"""Distance [m] up to which grasp_quality is 1."""


class Stack(Task):
    """Put A on B; see the module's docstring for the numbers."""

    robosuite_name = "Stack"
    takes_tensors = True
    proprioception = (*ARM_PARTS, *TOOL_PARTS)
    sensors = Sensors(
        bodies={"a": "cubeA_main", "b": "cubeB_main"},
        touches={
            "left_touch": ("left_fingerpad", "cubeA_main"),
            "right_touch": ("right_fingerpad", "cubeA_main"),
            "cubes_touch": ("cubeA_main", "cubeB_main"),
        },
    )
    horizon = 100
    milestone_names = ("near", "grasp", "lift", "aligned", "on", "stack")
    waypoint_names = NAMES
    weights: ClassVar[Weights] = rewards.WEIGHTS

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the cubes' poses; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        radius = {name: np.sqrt(2) * half for name, half in HALF.items()}
        spots = scatter(streams, dict.fromkeys(HALF, SPREAD), radius)
        for name, half in HALF.items():
            height = TABLE[2] + DROP + half
            cube = poses_with_any_yaw(streams, spots[name], height)
            qpos[:, scene.free_qpos(f"{name}_main")] = cube
        return Start(qpos)

    def sample_waypoint(
        self, milestone: str, scene: Scene, streams: EpisodeStreams
    ) -> Waypoint:
        """See `manip.tasks.stack_waypoints`."""
        start = self.sample_start(scene, streams)
        a, b = (scene.free_qpos(f"{name}_main") for name in HALF)
        for cube in a, b:
            start.qpos[:, cube][:, 2] -= DROP
        return place_cubes(milestone, streams, start, a, b)

    def measure(self, read: Measures) -> Measures:
        """Add offsets between the tool and the cubes, and the contacts of A.

        to_a [N, 3] m from the tool; distance [N] m, its length; from_b [N, 3] m from
        B's centre to A's; aside [N] m, its horizontal length; height [N] m of A's
        centre above the table; grasped [N] bool, robosuite's test; grasp_quality [N] in
        [0, 1], which falls to 0 as the tool slips off A; on [N] bool: A rests on B, and
        B on the table.
        """
        to_a, from_b = read["a_pos"] - read["eef_pos"], read["a_pos"] - read["b_pos"]
        xp = namespace(to_a)
        distance = xp.linalg.norm(to_a, axis=1)
        grasped = both_pads_touch(read)
        m = {
            **read,
            "to_a": to_a,
            "distance": distance,
            "from_b": from_b,
            "aside": xp.linalg.norm(from_b[:, :2], axis=1),
            "height": read["a_pos"][:, 2] - TABLE[2],
            "grasped": grasped,
            "grasp_quality": grasped * ramp(-distance, -GRASP_FAR, -GRASP_NEAR),
        }
        return {**m, "on": _rests_on_b(m)}

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and the tool, then the cubes, coarse and fine."""
        xp, a = namespace(m["a_quat"]), rotation_matrix(m["a_quat"])
        above = m["from_b"] - constant([0.0, 0.0, STACKED], m["from_b"])
        table = constant(TABLE, m["b_pos"])
        half = constant([0.0, 0.0, HALF["cubeB"]], m["b_pos"])
        return {
            **observe_arm_and_tool(m, CENTRE),
            "to_a": coarse(m["to_a"]),
            "from_b": coarse(m["from_b"]),
            "b_pos": 4.0 * (m["b_pos"] - table - half),
            "to_a_fine": fine(m["to_a"]),
            "above_fine": fine(above),
            "turn": cos_sin(4.0 * (yaw_angle(a) - yaw_angle(m["eef_mat"]))),
            "upright": a[:, 6:],
            "a_linvel": m["a_linvel"],
            "a_angvel": 0.2 * m["a_angvel"],
            "touch": xp.stack([m[name] for name in self.sensors.touches], axis=1),
            "on": floats(m["on"][:, None]),
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        return rewards.TERMS[reward](m, self.success(m))

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's and those of A (see `object_measures`); aside [N] m from B."""
        return {
            **super().visible_measures(m),
            **object_measures(m, "a"),
            "aside": m["aside"],
        }

    def success(self, m: Measures) -> Array:
        """A is on or against B, off the table, and not between the finger pads."""
        return (m["cubes_touch"] > 0) & (m["height"] > SUCCESS_HEIGHT) & ~m["grasped"]

    def expert(self, m: Measures) -> Array:
        """See `manip.tasks.experts.stack_expert`."""
        return stack_cubes(m, STACKED)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 3 cm of A; lift: by 3 cm; aligned: within 3 cm of B's axis.

        grasp: the grasp quality is positive; on: A rests on B; stack: success.
        """
        grasp = m["grasp_quality"] > 0
        lifted = grasp & (m["height"] - HALF["cubeA"] > 0.03)
        return {
            "near": m["distance"] < 0.03,
            "grasp": grasp,
            "lift": lifted,
            "aligned": lifted & (m["aside"] < 0.03),
            "on": m["on"],
            "stack": self.success(m),
        }


def _rests_on_b(m: Measures) -> Array:
    """[N] bool: A touches B and lies flat on it, and B on the table, each to 5 mm."""
    flat = abs(m["from_b"][:, 2] - STACKED) < 0.005
    b_down = abs(m["b_pos"][:, 2] - TABLE[2] - HALF["cubeB"]) < 0.005
    return (m["cubes_touch"] > 0) & flat & b_down & (m["aside"] < 0.03)
