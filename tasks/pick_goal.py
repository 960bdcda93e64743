"""PickGoal: hold a cube at a goal in the air. Our own robosuite `PickGoal`.

Success: the cube's centre is within 2.5 cm of the goal.
Failure: none; an episode ends by time.
Start: goal uniform in a box of 24 x 40 x 20 cm, 10 to 30 cm above the table; cube
    uniform in a rectangle of 20 x 30 cm about the table's centre, any yaw, on the
    table; arm in its default pose with 0.02 rad noise a joint, gripper half open. The
    cube's edge is 4 cm.
Shaped reward, in [0, 1] a step: 0.15 reach + 0.2 grasp + 0.15 lift + 0.25 carry
    + 0.25 at_goal. Reach is 1 - tanh(5 d) of the tool-cube distance d [m]; grasp rises
    from 0 to 1 as the gripper is told to close, lift over the first 5 cm, carry is lift
    times 1 - tanh(5 r) of the cube's distance r [m] from the goal, and at_goal falls
    from 1 within 1 cm to 0.1 at 5 cm beyond it. All but reach are paid only while both
    finger pads touch the cube and d < 2 cm, as in Lift.
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near, ramp, tolerance
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.cube import CUBE, PADS, closing, measure_cube, observe_cube, start_cube
from manip.tasks.experts.cube import take_cube
from manip.tasks.objects import rotation, turns, yaw
from manip.tasks.scenes.cube import HALF, SPREAD
from manip.tasks.scenes.pick_goal import GOAL_HIGH, GOAL_LOW, REACHED

Array = np.ndarray


class PickGoal(Task):
    """Hold the cube at the goal; see the module's docstring for the numbers."""

    robosuite_name = "PickGoal"
    sensors = Sensors(
        bodies=CUBE,
        sites={"goal": "goal"},
        touches=PADS,
        fields={"goal_place": ("site_pos", "goal")},
    )
    horizon = 100
    milestone_names = ("near", "grasp", "lift", "goal")
    weights: ClassVar[Weights] = {
        "shaped": {
            "reach": 0.15,
            "grasp": 0.2,
            "lift": 0.15,
            "carry": 0.25,
            "at_goal": 0.25,
        },
        "stock": {"reach": 0.25, "grasp": 0.25, "carry": 0.25, "goal": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Place goal and cube; see the module's docstring."""
        goal = streams.uniform(GOAL_LOW, GOAL_HIGH, 3)
        spots = streams.uniform(-SPREAD, SPREAD, 2)
        return Start(start_cube(scene, streams, spots, HALF), {"goal_place": goal})

    def measure(self, read: Measures) -> Measures:
        """Add what `measure_cube` does, and the goal from the cube.

        to_goal [N, 3] m, gap [N] m its length.
        """
        to_goal = read["goal_pos"] - read["cube_pos"]
        gap = np.linalg.norm(to_goal, axis=1)
        return {**measure_cube(read), "to_goal": to_goal, "gap": gap}

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and the cube, its turn from the tool's, then the goal."""
        turn = yaw(rotation(m["cube_quat"])) - yaw(m["eef_mat"])
        return {
            **observe_cube(m),
            "turn": turns(4.0 * turn),
            "goal_pos": 4.0 * (m["goal_pos"] - (GOAL_LOW + GOAL_HIGH) / 2),
            "to_goal": np.clip(10.0 * m["to_goal"], -5.0, 5.0),
            "to_goal_fine": 50.0 * np.clip(m["to_goal"], -0.02, 0.02),
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        if reward == "stock":
            pending = ~self.success(m)
            return {
                "reach": pending * near(m["distance"], 0.1),
                "grasp": pending * m["grasped"],
                "carry": pending * m["grasped"] * near(m["gap"], 0.1),
                "goal": self.success(m).astype(float),
            }
        lift = m["held"] * ramp(m["height"] - HALF, 0.0, 0.05)
        return {
            "reach": near(m["distance"], 0.2),
            "grasp": closing(m),
            "lift": lift,
            "carry": lift * near(m["gap"], 0.2),
            "at_goal": m["held"] * tolerance(m["gap"], 0.0, 0.01, margin=0.05),
        }

    def success(self, m: Measures) -> Array:
        """The cube's centre is within 2.5 cm of the goal."""
        return m["gap"] < REACHED

    def expert(self, m: Measures) -> Array:
        """Grasp the cube, and straight to the goal."""
        return take_cube(m, then=m["to_goal"])

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 3 cm of the cube; lift: held, 3 cm above its rest."""
        return {
            "near": m["distance"] < 0.03,
            "grasp": m["held"] > 0,
            "lift": (m["held"] > 0) & (m["height"] - HALF > 0.03),
            "goal": self.success(m),
        }
