"""A minimal task, for tests that need no particular one."""

from typing import ClassVar

import numpy as np

from manip.envs.task import Start, Task
from manip.sim.sensors import Sensors


class Tiny(Task):
    """Close the gripper; opening it is a failure."""

    robosuite_name = "Lift"
    sensors = Sensors()
    horizon = 8
    milestone_names = ("closed",)
    weights: ClassVar = {"shaped": {"closing": 1.0}}

    def sample_start(self, scene, streams) -> Start:
        return Start(np.tile(scene.layout.qpos, (len(streams), 1)))

    def measure(self, read):
        return read

    def observe(self, m):
        return {"joint_pos": m["joint_pos"], "closing": m["gripper_closing"][:, None]}

    def reward_terms(self, m, reward):
        return {"closing": (m["gripper_closing"] + 1) / 2}

    def success(self, m):
        return m["gripper_closing"] > 0.9

    def milestones(self, m):
        return {"closed": self.success(m)}

    def failure(self, m):
        return m["gripper_closing"] < -0.5
