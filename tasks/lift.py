"""Lift: raise a cube off the table. robosuite's `Lift`.

Success: the cube's centre is more than 4 cm above the table top (robosuite's test).
Failure: none; an episode ends by its time limit.
Start: cube centre uniform within +-3 cm of the table's centre, any yaw, 1 cm above the
    table; arm in its default pose with 0.02 rad noise per joint, gripper half open.
Shaped reward, in [0, 1] per step: 0.2 reach + 0.25 grasp + 0.55 lift + 0 upright.
    reach: 1 - tanh(5 d) of the distance d [m] from the tool to the cube.
    grasp: 0 unless both finger pads touch the cube. Rises from 0 to 1 as the gripper's
        command goes from open to closed, times a factor: 1 for d < 1.2 cm, falling to
        0 at d = 2 cm.
    lift: rises linearly over the first 5 cm of height.
    upright: falls from 1 to 0 as the hand's tilt grows from 0.1 to 0.5 rad. The recipe
        of SAC takes 0.1 of its weight from lift. Without it, SAC's hand leans by 35
        degrees (median over episodes of the largest tilt), and some cubes slip out.
    Without the distance factor, policies learned to press the pads onto the cube's top
    only. With a sharp edge at 2 cm, or with lift multiplied by grasp, they
    grasped the cube at its top, lost the reward as it slipped, and released it.
"""

from typing import ClassVar

import numpy as np

from manip.arrays import floats
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Waypoint, Weights
from manip.rewards.kernels import near, ramp
from manip.sim.robot_motion import hand_tilt
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import start_qpos
from manip.tasks.cube import (
    CUBE_BODY,
    PAD_TOUCHES,
    TABLE,
    grasp_cube,
    grasp_term,
    measure_cube,
    observe_cube,
)
from manip.tasks.experts.cube_expert import take_cube
from manip.tasks.object_measures import object_measures
from manip.tasks.rotations import yaw_quaternion

Array = np.ndarray

SPREAD = 0.03
"""Half width [m] of the square in which the cube starts
(robosuite/environments/manipulation/lift.py)."""
DROP = 0.01
"""Height [m] above the table from which the cube is dropped (ibid.)."""
SUCCESS_HEIGHT = 0.04
"""Height [m] of the cube's centre above the table, for success (ibid.)."""
REST = 0.021
"""Mean half size [m] of the cube; robosuite samples 2.0 to 2.2 cm (ibid.)."""


class Lift(Task):
    """Raise the cube; see the module's docstring for the numbers."""

    robosuite_name = "Lift"
    takes_tensors = True
    sensors = Sensors(bodies=CUBE_BODY, touches=PAD_TOUCHES)
    horizon = 100
    milestone_names = ("near", "grasp", "lift")
    waypoint_names = ("grasp",)
    weights: ClassVar[Weights] = {
        "shaped": {"reach": 0.2, "grasp": 0.25, "lift": 0.55, "upright": 0.0},
        "stock": {"reach": 1 / 2.25, "grasp": 0.25 / 2.25, "lift": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the cube's pose; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        cube = scene.free_qpos("cube_main")
        half = scene.geom_size("cube_g0")[2]
        spread = np.array([SPREAD, SPREAD, 0.0])
        spot = TABLE + np.array([0.0, 0.0, DROP + half])
        position = spot + streams.uniform(-spread, spread, 3)
        turn = yaw_quaternion(streams.uniform(0, 2 * np.pi, 1)[:, 0])
        qpos[:, cube] = np.concatenate([position, turn], axis=1)
        return Start(qpos)

    def sample_waypoint(
        self, milestone: str, scene: Scene, streams: EpisodeStreams
    ) -> Waypoint:
        """The cube in the closed hand, on the table."""
        start = self.sample_start(scene, streams)
        start.qpos[:, scene.free_qpos("cube_main")][:, 2] -= DROP
        return grasp_cube(scene, streams, start)

    def measure(self, read: Measures) -> Measures:
        """See `measure_cube`."""
        return measure_cube(read)

    def observe(self, m: Measures) -> dict[str, Array]:
        """See `observe_cube`."""
        return observe_cube(m)

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        if reward == "stock":
            pending = ~self.success(m)
            return {
                "reach": pending * near(m["distance"], 0.1),
                "grasp": pending * m["grasped"],
                "lift": floats(self.success(m)),
            }
        return {
            "reach": near(m["distance"], 0.2),
            "grasp": grasp_term(m),
            "lift": ramp(m["height"] - REST, 0.0, 0.05),
            "upright": 1.0 - ramp(hand_tilt(m["eef_mat"]), 0.1, 0.5),
        }

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's, then the cube's (see `object_measures`)."""
        return {**super().visible_measures(m), **object_measures(m, "cube")}

    def success(self, m: Measures) -> Array:
        """The cube's centre is more than 4 cm above the table."""
        return m["height"] > SUCCESS_HEIGHT

    def expert(self, m: Measures) -> Array:
        """Grasp the cube, then move up."""
        up = np.array([0.0, 0.0, 0.1])
        return take_cube(m, then=np.tile(up, (len(m["to_cube"]), 1)))

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 3 cm of the cube; grasp: both pads touch; lift: success."""
        return {
            "near": m["distance"] < 0.03,
            "grasp": m["grasped"],
            "lift": self.success(m),
        }
