"""Press: push a spring-loaded button down. An example of a user's own task.

Success: the button is more than 10 mm down, of at most 15 mm.
Failure: none; an episode ends at its time limit.
Start: button uniform in a square of 24 cm on the table; arm in its default pose with
    0.02 rad noise per joint.
Shaped reward, in [0, 1] per step: 0.4 near + 0.6 press, where near is 1 - tanh(5 d) of
    the distance d [m] from the tool to the button's top, and press rises linearly
    over the first 10 mm.
"""

from typing import Any, ClassVar
from xml.etree import ElementTree

import numpy as np
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import TableArena
from robosuite.models.tasks import ManipulationTask

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near, ramp
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import observe_arm, start_qpos

Array = np.ndarray

DOWN = 0.010
"""Success depth [m] of the button."""
LOW, HIGH = np.array([-0.12, -0.12, 0.8]), np.array([0.12, 0.12, 0.8])
"""Corners [m] of the square on the table in which the button is placed."""
TOP = np.array([0.0, 0.0, 0.015])
"""Position [m] of the button's top relative to its centre."""

MJCF = """
<body name="socket" pos="0 0 0.8">
  <geom type="cylinder" size="0.055 0.01" pos="0 0 0.01" group="1"
        rgba="0.2 0.2 0.2 1" contype="0" conaffinity="0"/>
  <body name="button" pos="0 0 0.04" gravcomp="1">
    <joint name="button" type="slide" axis="0 0 1" range="-0.015 0" limited="true"
           stiffness="1000" damping="20" solreflimit="0.004 1"/>
    <geom type="cylinder" size="0.045 0.015" group="0" mass="0.1"/>
    <geom type="cylinder" size="0.045 0.015" group="1" rgba="0.8 0.1 0.1 1"
          contype="0" conaffinity="0"/>
  </body>
</body>
"""


class Button(ManipulationEnv):
    """A robosuite environment: an arm, a table, a button. Reward: 1 on success."""

    def __init__(
        self, robots: Any, initialization_noise: Any = "default", **options: Any
    ) -> None:
        options.pop("reward_shaping", None)
        super().__init__(robots, initialization_noise=initialization_noise, **options)

    def _load_model(self) -> None:
        super()._load_model()
        robot = self.robots[0].robot_model
        robot.set_base_xpos(robot.base_xpos_offset["table"](0.8))
        arena = TableArena(table_full_size=(0.8, 0.8, 0.05), table_offset=(0, 0, 0.8))
        arena.set_origin([0, 0, 0])
        arena.worldbody.append(ElementTree.fromstring(MJCF))
        self.model = ManipulationTask(mujoco_arena=arena, mujoco_robots=[robot])

    def _reset_internal(self) -> None:
        super()._reset_internal()
        place = self.rng.uniform(LOW, HIGH)
        self.sim.model.body_pos[self.sim.model.body_name2id("socket")] = place

    def reward(self, action: Array | None = None) -> float:
        """Reward of the current state; `action` is not used."""
        return float(self._check_success())

    def _check_success(self) -> bool:
        return bool(self.sim.data.get_joint_qpos("button") < -DOWN)


class Press(Task):
    """Push the button down; see the module's docstring for the numbers."""

    robosuite_name = "Button"
    sensors = Sensors(
        bodies={"button": "button"},
        joints={"button": "button"},
        fields={"socket_place": ("body_pos", "socket")},
    )
    horizon = 60
    milestone_names = ("near", "press")
    weights: ClassVar[Weights] = {"shaped": {"near": 0.4, "press": 0.6}}

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Place the button; see the module's docstring."""
        place = streams.uniform(LOW, HIGH, 3)
        return Start(start_qpos(scene, streams), {"socket_place": place})

    def measure(self, read: Measures) -> Measures:
        """Add to_button [N, 3] m from the tool to its top, distance and depth [N] m."""
        to_button = read["button_pos"] + TOP - read["eef_pos"]
        distance = np.linalg.norm(to_button, axis=1)
        depth = -read["button_qpos"][:, 0]
        return {**read, "to_button": to_button, "distance": distance, "depth": depth}

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm, then the button: offset from the tool, depth."""
        button = {"to_button": 10 * m["to_button"], "depth": 100 * m["depth"][:, None]}
        return {**observe_arm(m, (LOW + HIGH) / 2), **button}

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped reward, the only one."""
        return {"near": near(m["distance"], 0.2), "press": ramp(m["depth"], 0.0, DOWN)}

    def success(self, m: Measures) -> Array:
        """The button is more than 10 mm down."""
        return m["depth"] > DOWN

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 8 cm of the button; press: success."""
        return {"near": m["distance"] < 0.08, "press": self.success(m)}

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's; distance [N] m to the button's top, and its depth [N] m."""
        button = {"distance": m["distance"], "depth": m["depth"]}
        return {**super().visible_measures(m), **button}

    def expert(self, m: Measures) -> Array:
        """Move over the button, then down onto it with closed fingers."""
        action = np.zeros((len(m["distance"]), 7))
        action[:, :3] = np.clip(20 * m["to_button"], -1, 1)
        aside = np.linalg.norm(m["to_button"][:, :2], axis=1) > 0.02
        action[:, 2] = np.where(aside, np.minimum(action[:, 2] + 0.5, 1), -1.0)
        action[:, 6] = 1.0
        return action
