"""PickGoal: hold a cube at a goal in the air.

robosuite does not have this task: `scenes.pick_goal_scene` defines its environment.

Success: the cube's centre is within 2.5 cm of the goal.
Failure: none; an episode ends by its time limit.
Start: goal uniform in a box of 24 x 40 x 20 cm, 10 to 30 cm above the table; cube
    uniform in a rectangle of 20 x 30 cm around the table's centre, any yaw, on the
    table; arm in its default pose with 0.02 rad noise per joint, gripper half open. The
    cube's edge is 4 cm.
Shaped reward, in [0, 1] per step: 0.15 reach + 0.2 grasp + 0.15 lift + 0.25 carry
    + 0.25 at_goal.
    reach: 1 - tanh(5 d) of the distance d [m] from the tool to the cube.
    grasp: as in Lift.
    lift: rises linearly over the first 5 cm of height.
    carry: lift times 1 - tanh(5 r) of the cube's distance r [m] from the goal.
    at_goal: 1 for r <= 1 cm, falling to 0.1 at r = 6 cm.
    All terms but reach are multiplied by the grasp quality of Lift: 0 unless both
    finger pads touch the cube, 1 for d < 1.2 cm, falling to 0 at d = 2 cm.
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Waypoint, Weights
from manip.rewards.kernels import near, ramp, tolerance
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.cube import (
    CUBE_BODY,
    PAD_TOUCHES,
    grasp_cube,
    grasp_term,
    measure_cube,
    observe_cube,
    start_cube,
)
from manip.tasks.experts.cube_expert import take_cube
from manip.tasks.object_measures import object_measures
from manip.tasks.offsets import fine
from manip.tasks.rotations import cos_sin, rotation_matrix, yaw_angle
from manip.tasks.scenes.cube_scene import HALF, SPREAD
from manip.tasks.scenes.pick_goal_scene import GOAL_HIGH, GOAL_LOW, SUCCESS_DISTANCE

Array = np.ndarray


class PickGoal(Task):
    """Hold the cube at the goal; see the module's docstring for the numbers."""

    robosuite_name = "PickGoal"
    sensors = Sensors(
        bodies=CUBE_BODY,
        sites={"goal": "goal"},
        touches=PAD_TOUCHES,
        fields={"goal_place": ("site_pos", "goal")},
    )
    horizon = 100
    milestone_names = ("near", "grasp", "lift", "goal")
    waypoint_names = ("grasp", "lift")
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
        """Draw the goal and the cube's pose; see the module's docstring."""
        goal = streams.uniform(GOAL_LOW, GOAL_HIGH, 3)
        spots = streams.uniform(-SPREAD, SPREAD, 2)
        return Start(start_cube(scene, streams, spots, HALF), {"goal_place": goal})

    def sample_waypoint(
        self, milestone: str, scene: Scene, streams: EpisodeStreams
    ) -> Waypoint:
        """The cube in the closed hand: on the table, or on its way to the goal."""
        start = self.sample_start(scene, streams)
        cube, goal = scene.free_qpos("cube_main"), start.fields["goal_place"]
        if milestone == "lift":
            spot, way = start.qpos[:, cube][:, :3], streams.uniform(0.35, 1, 1)
            start.qpos[:, cube.start : cube.start + 3] += way * (goal - spot)
        return grasp_cube(scene, streams, start)

    def measure(self, read: Measures) -> Measures:
        """As `measure_cube`, and the offset of the goal from the cube.

        to_goal [N, 3] m; gap [N] m, its length.
        """
        to_goal = read["goal_pos"] - read["cube_pos"]
        gap = np.linalg.norm(to_goal, axis=1)
        return {**measure_cube(read), "to_goal": to_goal, "gap": gap}

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and the cube, its yaw relative to the tool, then the goal."""
        turn = yaw_angle(rotation_matrix(m["cube_quat"])) - yaw_angle(m["eef_mat"])
        return {
            **observe_cube(m),
            "turn": cos_sin(4.0 * turn),
            "goal_pos": 4.0 * (m["goal_pos"] - (GOAL_LOW + GOAL_HIGH) / 2),
            "to_goal": np.clip(10.0 * m["to_goal"], -5.0, 5.0),
            "to_goal_fine": fine(m["to_goal"]),
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
        lift = m["grasp_quality"] * ramp(m["height"] - HALF, 0.0, 0.05)
        return {
            "reach": near(m["distance"], 0.2),
            "grasp": grasp_term(m),
            "lift": lift,
            "carry": lift * near(m["gap"], 0.2),
            "at_goal": m["grasp_quality"] * tolerance(m["gap"], 0.0, 0.01, margin=0.05),
        }

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's and the cube's (see `object_measures`); goal_distance [N] m."""
        return {
            **super().visible_measures(m),
            **object_measures(m, "cube"),
            "goal_distance": m["gap"],
        }

    def success(self, m: Measures) -> Array:
        """The cube's centre is within 2.5 cm of the goal."""
        return m["gap"] < SUCCESS_DISTANCE

    def expert(self, m: Measures) -> Array:
        """Grasp the cube, then move it straight to the goal."""
        return take_cube(m, then=m["to_goal"])

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 3 cm of the cube; lift: grasped, 3 cm above its rest.

        grasp: the grasp quality is positive; goal: success.
        """
        return {
            "near": m["distance"] < 0.03,
            "grasp": m["grasp_quality"] > 0,
            "lift": (m["grasp_quality"] > 0) & (m["height"] - HALF > 0.03),
            "goal": self.success(m),
        }
