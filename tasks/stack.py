"""Stack: put the small cube A on the big cube B. robosuite's `Stack`.

Success: A touches B, its centre is more than 4 cm above the table, and the finger pads
    do not both touch A (robosuite's test).
Failure: none; an episode ends by time.
Start: both cubes' centres uniform within +-8 cm of the table's, their circles apart,
    any yaw, 1 cm above the table; arm in its default pose with 0.02 rad noise a joint,
    gripper half open. A's edge is 4 cm, B's 5 cm.
Shaped reward, in [0, 1] a step: 0.08 reach + 0.08 grasp + 0.08 lift + 0.16 align
    + 0.12 lower + 0.05 on + 0.13 open + 0.15 release + 0.15 clear. Reach is
    1 - tanh(5 d) of the tool-A distance d [m]; grasp rises from 0 to 1 as the gripper
    is told to close, lift over the first 5 cm, align is lift times 1 - tanh(6 r) of the
    horizontal distance r [m] to B, and lower rises over the last 5 cm above B, times
    1 - tanh(25 r); these are paid only while both finger pads touch A, in full where
    d < 1.5 cm, not at all where d > 2.5 cm. Once A rests on B they are paid in full
    with `on`; open grows from 0 to 1 as the gripper is told to open, release is
    success, and clear rises with it until the tool is 6 cm away. (A held above B earns
    at most 0.52, A held on B 0.57: agents stay for ever where the next stage pays less,
    little more, or pays only at its end. Without `open` they let one pad leave A by a
    hair's breadth, and lose it again; without `clear` the hand stays, and knocks A
    down.)
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near, ramp
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import observe_arm, start_qpos
from manip.tasks.experts.stack import stack
from manip.tasks.objects import poses, rotation, scatter, turns, yaw

Array = np.ndarray

TABLE = np.array([0.0, 0.0, 0.8])
"""Centre of the table top [m] (robosuite/environments/manipulation/stack.py)."""
CENTRE = TABLE + np.array([0.0, 0.0, 0.15])
"""Origin [m] of the tool's place in observations."""
HALF = {"cubeA": 0.02, "cubeB": 0.025}
"""Half an edge [m] of each cube (ibid.)."""
SPREAD = np.array([0.08, 0.08])
"""Half width [m] of the square in which the cubes start (ibid.)."""
DROP = 0.01
"""Height [m] above the table from which the cubes are dropped (ibid.)."""
LIFTED = 0.04
"""Success height [m] of A's centre above the table (ibid.)."""
AROUND = 0.025
"""Distance [m] of the tool from A's centre, below which it is around it."""
CENTRED = 0.015
"""Distance [m] below which it is fully so."""
CLEAR = 0.06
"""Distance [m] of the tool from A's centre, from which it does not disturb it."""
STACKED = HALF["cubeA"] + HALF["cubeB"]
"""Height [m] of A's centre above B's when A lies on B."""


class Stack(Task):
    """Put A on B; see the module's docstring for the numbers."""

    robosuite_name = "Stack"
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
    weights: ClassVar[Weights] = {
        "shaped": {
            "reach": 0.08,
            "grasp": 0.08,
            "lift": 0.08,
            "align": 0.16,
            "lower": 0.12,
            "on": 0.05,
            "open": 0.13,
            "release": 0.15,
            "clear": 0.15,
        },
        "stock": {
            "reach": 0.125,
            "grasp": 0.125,
            "lift": 0.5,
            "align": 0.25,
            "stack": 1.0,
        },
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Place the cubes; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        radius = {name: np.sqrt(2) * half for name, half in HALF.items()}
        spots = scatter(streams, dict.fromkeys(HALF, SPREAD), radius)
        for name, half in HALF.items():
            cube = scene.free_qpos(f"{name}_main")
            qpos[:, cube] = poses(streams, spots[name], TABLE[2] + DROP + half)
        return Start(qpos)

    def measure(self, read: Measures) -> Measures:
        """Add what is between the tool and the cubes, and what A touches.

        to_a [N, 3] m from the tool, distance [N] m; from_b [N, 3] m of A's centre,
        aside [N] m its horizontal part; height [N] m of A's centre above the table;
        grasped [N] is robosuite's test, held [N] in [0, 1] falls to 0 as the tool slips
        off A; on [N]: A rests on B, and B on the table.
        """
        to_a, from_b = read["a_pos"] - read["eef_pos"], read["a_pos"] - read["b_pos"]
        distance = np.linalg.norm(to_a, axis=1)
        grasped = (read["left_touch"] > 0) & (read["right_touch"] > 0)
        m = {
            **read,
            "to_a": to_a,
            "distance": distance,
            "from_b": from_b,
            "aside": np.linalg.norm(from_b[:, :2], axis=1),
            "height": read["a_pos"][:, 2] - TABLE[2],
            "grasped": grasped,
            "held": grasped * ramp(-distance, -AROUND, -CENTRED),
        }
        return {**m, "on": _rests_on_b(m)}

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and how it is turned, then the cubes, coarse and fine."""
        tool, a = m["eef_mat"], rotation(m["a_quat"])
        above = m["from_b"] - [0.0, 0.0, STACKED]
        return {
            **observe_arm(m, CENTRE),
            "tool_yaw": turns(yaw(tool)),
            "tool_tilt": 3.0 * tool[:, [2, 5]],
            "to_a": 10.0 * np.clip(m["to_a"], -0.3, 0.3),
            "from_b": 10.0 * np.clip(m["from_b"], -0.3, 0.3),
            "b_pos": 4.0 * (m["b_pos"] - TABLE - [0.0, 0.0, HALF["cubeB"]]),
            "to_a_fine": 50.0 * np.clip(m["to_a"], -0.02, 0.02),
            "above_fine": 50.0 * np.clip(above, -0.02, 0.02),
            "turn": turns(4.0 * (yaw(a) - yaw(tool))),
            "upright": a[:, 6:],
            "a_linvel": m["a_linvel"],
            "a_angvel": 0.2 * m["a_angvel"],
            "touch": np.stack([m[name] for name in self.sensors.touches], axis=1),
            "on": m["on"][:, None].astype(float),
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        if reward == "stock":
            return self._stock_terms(m)
        on, held = m["on"], m["held"]
        lift = held * ramp(m["height"] - HALF["cubeA"], 0.0, 0.05)
        return {
            "reach": np.maximum(on, near(m["distance"], 0.2)),
            "grasp": np.maximum(on, held * ramp(m["gripper_closing"], -1.0, 1.0)),
            "lift": np.maximum(on, lift),
            "align": np.maximum(on, lift * near(m["aside"], 1 / 6)),
            "lower": np.maximum(on, held * _lowered(m)),
            "on": on.astype(float),
            "open": on * ramp(-m["gripper_closing"], -1.0, 1.0),
            "release": on * self.success(m).astype(float),
            "clear": on * self.success(m) * ramp(m["distance"], 0.0, CLEAR),
        }

    def _stock_terms(self, m: Measures) -> dict[str, Array]:
        stacked, lifted = self.success(m), m["height"] > LIFTED
        return {
            "reach": ~lifted * near(m["distance"], 0.1),
            "grasp": ~lifted * m["grasped"],
            "lift": (lifted & ~stacked).astype(float),
            "align": (lifted & ~stacked) * near(m["aside"], 1.0),
            "stack": stacked.astype(float),
        }

    def success(self, m: Measures) -> Array:
        """A is on or against B, off the table, and not between the finger pads."""
        return (m["cubes_touch"] > 0) & (m["height"] > LIFTED) & ~m["grasped"]

    def expert(self, m: Measures) -> Array:
        """As `manip.tasks.experts.stack`."""
        return stack(m, STACKED)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 3 cm of A; lift: by 3 cm; aligned: 3 cm beside B; on."""
        lifted = (m["held"] > 0) & (m["height"] - HALF["cubeA"] > 0.03)
        return {
            "near": m["distance"] < 0.03,
            "grasp": m["held"] > 0,
            "lift": lifted,
            "aligned": lifted & (m["aside"] < 0.03),
            "on": m["on"],
            "stack": self.success(m),
        }


def _rests_on_b(m: Measures) -> Array:
    """A touches B, lies flat on it, and B on the table, each to 5 mm."""
    flat = np.abs(m["from_b"][:, 2] - STACKED) < 0.005
    down = np.abs(m["b_pos"][:, 2] - TABLE[2] - HALF["cubeB"]) < 0.005
    return (m["cubes_touch"] > 0) & flat & down & (m["aside"] < 0.03)


def _lowered(m: Measures) -> Array:
    """[N] in [0, 1]: how near A is to lying on B, from 5 cm above it and not beside."""
    above = m["from_b"][:, 2] - STACKED
    over = near(m["aside"], 0.04) * (above > -0.005)
    return over * ramp(-above, -0.05, 0.0)
