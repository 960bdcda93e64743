"""Push: slide a cube to a goal on the table. Our own robosuite `Push`.

Success: the cube's centre is within 3 cm of the goal, horizontally, and less than 1 cm
    above its rest on the table.
Failure: none; an episode ends by time.
Start: goal uniform in a rectangle of 24 x 40 cm about the table's centre, cube uniform
    in one of 20 x 30 cm and at least 10 cm from the goal, any yaw, on the table; arm in
    its default pose with 0.02 rad noise a joint, gripper half open. The cube's edge is
    4 cm. The gripper is free: an arm may push, cage or drag.
Shaped reward, in [0, 1] a step: 0.15 reach + 0.2 grasp + 0.3 slide + 0.35 at_goal.
    Reach is 1 - tanh(5 d) of the tool-cube distance d [m], grasp is Lift's, slide is
    1 - tanh(5 r) of the cube's horizontal distance r [m] from the goal, and at_goal
    falls from 1 within 1 cm to 0.1 at 5 cm beyond it, and linearly to 0 as the cube
    rises by 5 cm. (Without grasp, agents wedge the cube between fingers and table, and
    learn no way to move it from there: 3 % after 75,000 steps. With slide, too, bound
    to the table they shun the grasp, which tilts the cube: 2 % after 100,000.)
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near, ramp, tolerance
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.cube import (
    CUBE,
    PADS,
    TABLE,
    closing,
    measure_cube,
    observe_cube,
    start_cube,
)
from manip.tasks.experts.cube import take_cube
from manip.tasks.objects import rotation, scatter, turns, yaw
from manip.tasks.scenes.cube import HALF, SPREAD
from manip.tasks.scenes.push import APART, DOWN, GOAL_HIGH, REACHED

Array = np.ndarray


class Push(Task):
    """Slide the cube to the goal; see the module's docstring for the numbers."""

    robosuite_name = "Push"
    sensors = Sensors(
        bodies=CUBE,
        sites={"goal": "goal"},
        touches=PADS,
        fields={"goal_place": ("site_pos", "goal")},
    )
    horizon = 100
    milestone_names = ("near", "close", "push")
    weights: ClassVar[Weights] = {
        "shaped": {"reach": 0.15, "grasp": 0.2, "slide": 0.3, "at_goal": 0.35},
        "stock": {"reach": 0.25, "slide": 0.5, "push": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Place goal and cube; see the module's docstring."""
        half = {"goal": (GOAL_HIGH - TABLE)[:2], "cube": SPREAD}
        spots = scatter(streams, half, dict.fromkeys(half, APART / 2))
        goal = np.column_stack([spots["goal"], np.full(len(streams), TABLE[2])])
        qpos = start_cube(scene, streams, spots["cube"], HALF)
        return Start(qpos, {"goal_place": goal})

    def measure(self, read: Measures) -> Measures:
        """Add what `measure_cube` does, and where the goal is from the cube.

        to_goal [N, 2] m horizontal, gap [N] m its length; down [N]: cube on the table.
        """
        m = measure_cube(read)
        to_goal = (read["goal_pos"] - read["cube_pos"])[:, :2]
        return {
            **m,
            "to_goal": to_goal,
            "gap": np.linalg.norm(to_goal, axis=1),
            "down": m["height"] - HALF < DOWN,
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and the cube, its turn from the tool's, then the goal."""
        turn = yaw(rotation(m["cube_quat"])) - yaw(m["eef_mat"])
        return {
            **observe_cube(m),
            "turn": turns(4.0 * turn),
            "goal_pos": 4.0 * (m["goal_pos"] - TABLE)[:, :2],
            "to_goal": np.clip(10.0 * m["to_goal"], -5.0, 5.0),
            "to_goal_fine": 50.0 * np.clip(m["to_goal"], -0.02, 0.02),
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        if reward == "stock":
            pending = ~self.success(m)
            return {
                "reach": pending * near(m["distance"], 0.1),
                "slide": pending * near(m["gap"], 0.1),
                "push": self.success(m).astype(float),
            }
        low = ramp(HALF - m["height"], -0.05, 0.0)
        return {
            "reach": near(m["distance"], 0.2),
            "grasp": closing(m),
            "slide": near(m["gap"], 0.2),
            "at_goal": low * tolerance(m["gap"], 0.0, 0.01, margin=0.05),
        }

    def success(self, m: Measures) -> Array:
        """The cube is on the table, within 3 cm of the goal."""
        return m["down"] & (m["gap"] < REACHED)

    def expert(self, m: Measures) -> Array:
        """Grasp the cube, and drag it over the table to the goal."""
        return take_cube(m, then=np.column_stack([m["to_goal"], HALF - m["height"]]))

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 5 cm of the cube; close: cube within 6 cm of the goal."""
        return {
            "near": m["distance"] < 0.05,
            "close": m["down"] & (m["gap"] < 2 * REACHED),
            "push": self.success(m),
        }
