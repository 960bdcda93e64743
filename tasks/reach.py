"""Reach: bring the tool to a goal point above the table.

robosuite does not have this task: `scenes.reach_scene` defines its environment.

Success: the grip site is within 2 cm of the goal.
Failure: none; an episode ends by its time limit.
Start: goal uniform in a box of 30 x 50 x 30 cm, 10 to 40 cm above the table; arm in
    its default pose with 0.02 rad noise per joint.
Shaped reward, in [0, 1] per step: 0.5 near + 0.5 at_goal.
    near: 1 - tanh(5 d) of the distance d [m] from the tool to the goal.
    at_goal: 1 for d <= 1 cm, falling to 0.1 at d = 9 cm.
"""

from typing import ClassVar

import numpy as np

from manip.arrays import constant, namespace
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near, tolerance
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import observe_arm, start_qpos
from manip.tasks.experts.motion import move_action
from manip.tasks.scenes.reach_scene import GOAL_HIGH, GOAL_LOW, SUCCESS_DISTANCE

Array = np.ndarray


class Reach(Task):
    """Bring the tool to the goal; see the module's docstring for the numbers."""

    robosuite_name = "Reach"
    takes_tensors = True
    sensors = Sensors(
        sites={"goal": "goal"}, fields={"goal_place": ("site_pos", "goal")}
    )
    horizon = 80
    milestone_names = ("near", "reach")
    weights: ClassVar[Weights] = {
        "shaped": {"near": 0.5, "at_goal": 0.5},
        "stock": {"reach": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the goal; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        return Start(qpos, {"goal_place": streams.uniform(GOAL_LOW, GOAL_HIGH, 3)})

    def measure(self, read: Measures) -> Measures:
        """Add to_goal [N, 3] m and distance [N] m, from the tool."""
        to_goal = read["goal_pos"] - read["eef_pos"]
        return {
            **read,
            "to_goal": to_goal,
            "distance": namespace(to_goal).linalg.norm(to_goal, axis=1),
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm, then the goal: position, and offset from the tool."""
        centre = (GOAL_LOW + GOAL_HIGH) / 2
        goal, to_goal = m["goal_pos"], m["to_goal"]
        return {
            **observe_arm(m, centre),
            "goal_pos": 4.0 * (goal - constant(centre, goal)),
            "to_goal": namespace(to_goal).clip(10.0 * to_goal, -5.0, 5.0),
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        if reward == "stock":
            xp, close = namespace(m["distance"]), near(m["distance"], 0.1)
            return {"reach": xp.where(self.success(m), 1.0, close)}
        return {
            "near": near(m["distance"], 0.2),
            "at_goal": tolerance(m["distance"], 0.0, 0.01, margin=0.08),
        }

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's; goal_distance [N] m from the tool."""
        return {**super().visible_measures(m), "goal_distance": m["distance"]}

    def success(self, m: Measures) -> Array:
        """The tool is within 2 cm of the goal."""
        return m["distance"] < SUCCESS_DISTANCE

    def expert(self, m: Measures) -> Array:
        """Move straight to the goal."""
        return move_action(m["to_goal"], np.ones(len(m["to_goal"])))

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 10 cm of the goal; reach: success."""
        return {"near": m["distance"] < 0.1, "reach": self.success(m)}
