"""Push: slide a cube to a goal on the table.

robosuite does not have this task: `scenes.push_scene` defines its environment.

Success: the cube's centre is within 3 cm of the goal, horizontally, and less than 1 cm
    above its height at rest on the table.
Failure: none; an episode ends by its time limit.
Start: goal uniform in a rectangle of 24 x 40 cm around the table's centre; cube uniform
    in one of 20 x 30 cm and at least 10 cm from the goal, any yaw, on the table; arm in
    its default pose with 0.02 rad noise per joint, gripper half open. The cube's edge
    is 4 cm. The gripper is controlled: a policy may push, cage or drag the cube.
Shaped reward, in [0, 1] per step: 0.15 reach + 0.2 grasp + 0.3 slide + 0.35 at_goal.
    reach: 1 - tanh(5 d) of the distance d [m] from the tool to the cube.
    grasp: as in Lift.
    slide: 1 - tanh(5 r) of the cube's horizontal distance r [m] from the goal.
    at_goal: 1 for r <= 1 cm, falling to 0.1 at r = 6 cm; times the mean of two factors
        that fall linearly from 1 to 0 as the cube rises by 1 cm, and by 5 cm.
    Without grasp, policies wedged the cube between fingers and table and could not move
    it from there: 3 % success after 75,000 steps. With the height factor on slide as
    well, they avoided the grasp, which tilts the cube: 2 % after 100,000 steps.
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
    TABLE,
    grasp_cube,
    grasp_term,
    measure_cube,
    observe_cube,
    start_cube,
)
from manip.tasks.experts.cube_expert import take_cube
from manip.tasks.object_measures import diagonal_speed, object_measures
from manip.tasks.offsets import fine
from manip.tasks.placement import scatter
from manip.tasks.rotations import cos_sin, rotation_matrix, yaw_angle
from manip.tasks.scenes.cube_scene import HALF, SPREAD
from manip.tasks.scenes.push_scene import (
    GOAL_HIGH,
    MIN_START_DISTANCE,
    REST_TOLERANCE,
    SUCCESS_DISTANCE,
)

Array = np.ndarray


class Push(Task):
    """Slide the cube to the goal; see the module's docstring for the numbers."""

    robosuite_name = "Push"
    sensors = Sensors(
        bodies=CUBE_BODY,
        sites={"goal": "goal"},
        touches=PAD_TOUCHES,
        fields={"goal_place": ("site_pos", "goal")},
    )
    horizon = 100
    milestone_names = ("near", "close", "push")
    waypoint_names = ("near", "close")
    weights: ClassVar[Weights] = {
        "shaped": {"reach": 0.15, "grasp": 0.2, "slide": 0.3, "at_goal": 0.35},
        "stock": {"reach": 0.25, "slide": 0.5, "push": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the goal and the cube's pose; see the module's docstring."""
        half = {"goal": (GOAL_HIGH - TABLE)[:2], "cube": SPREAD}
        spots = scatter(streams, half, dict.fromkeys(half, MIN_START_DISTANCE / 2))
        goal = np.column_stack([spots["goal"], np.full(len(streams), TABLE[2])])
        qpos = start_cube(scene, streams, spots["cube"], HALF)
        return Start(qpos, {"goal_place": goal})

    def sample_waypoint(
        self, milestone: str, scene: Scene, streams: EpisodeStreams
    ) -> Waypoint:
        """The cube in the closed hand, on the table: at its start, or near the goal."""
        start = self.sample_start(scene, streams)
        cube, goal = scene.free_qpos("cube_main"), start.fields["goal_place"][:, :2]
        if milestone == "close":
            aside = SUCCESS_DISTANCE * streams.uniform(1.05, 1.9, 1)
            angle = streams.uniform(0, 2 * np.pi, 1)[:, 0]
            start.qpos[:, cube.start : cube.start + 2] = goal + aside * cos_sin(angle)
        return grasp_cube(scene, streams, start)

    def measure(self, read: Measures) -> Measures:
        """As `measure_cube`, and the offset of the goal from the cube.

        to_goal [N, 2] m, horizontal; gap [N] m, its length; on_table [N] bool.
        """
        m = measure_cube(read)
        to_goal = (read["goal_pos"] - read["cube_pos"])[:, :2]
        return {
            **m,
            "to_goal": to_goal,
            "gap": np.linalg.norm(to_goal, axis=1),
            "on_table": m["height"] - HALF < REST_TOLERANCE,
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and the cube, its yaw relative to the tool, then the goal."""
        turn = yaw_angle(rotation_matrix(m["cube_quat"])) - yaw_angle(m["eef_mat"])
        return {
            **observe_cube(m),
            "turn": cos_sin(4.0 * turn),
            "goal_pos": 4.0 * (m["goal_pos"] - TABLE)[:, :2],
            "to_goal": np.clip(10.0 * m["to_goal"], -5.0, 5.0),
            "to_goal_fine": fine(m["to_goal"]),
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
        fall = HALF - m["height"]
        low = (ramp(fall, -0.01, 0.0) + ramp(fall, -0.05, 0.0)) / 2
        return {
            "reach": near(m["distance"], 0.2),
            "grasp": grasp_term(m),
            "slide": near(m["gap"], 0.2),
            "at_goal": low * tolerance(m["gap"], 0.0, 0.01, margin=0.05),
        }

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's and the cube's (see `object_measures`), then of its path.

        goal_distance [N] m from the cube, horizontal; diagonal_speed [N] m/s of the
        cube, see the function of this name.
        """
        return {
            **super().visible_measures(m),
            **object_measures(m, "cube"),
            "goal_distance": m["gap"],
            "diagonal_speed": diagonal_speed(m["cube_linvel"]),
        }

    def success(self, m: Measures) -> Array:
        """The cube is on the table, within 3 cm of the goal."""
        return m["on_table"] & (m["gap"] < SUCCESS_DISTANCE)

    def expert(self, m: Measures) -> Array:
        """Grasp the cube, then drag it over the table to the goal."""
        return take_cube(m, then=np.column_stack([m["to_goal"], HALF - m["height"]]))

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 5 cm of the cube; close: cube within 6 cm of the goal.

        push: success.
        """
        return {
            "near": m["distance"] < 0.05,
            "close": m["on_table"] & (m["gap"] < 2 * SUCCESS_DISTANCE),
            "push": self.success(m),
        }
