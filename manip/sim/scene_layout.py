"""SceneLayout: indices, names and gains of a robosuite environment.

They are read from the environment's own objects, so that every arm, gripper and task
of robosuite works, on the batch engine and in stock robosuite.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from manip.arrays import constant
from manip.errors import UserError
from manip.sim.fields import field_slots
from manip.sim.robot_model import (
    NARROWEST,
    WIDE,
    WIDEST,
    Gripper,
    Robot,
    default_qpos,
    finger_indices,
    hand_kind,
    read_robots,
    reading_prefix,
)
from manip.sim.sensors import Sensors
from manip.sim.slots import Slot, robot_slots, task_slots
from manip.sim.touches import Touch, read_touches

Array = np.ndarray


@dataclass(frozen=True)
class SceneLayout:
    """Indices and gains of a robosuite environment's robots, and a task's sensors.

    Attributes:
        robots: K robots of one kind, each an arm of n joints with m finger joints.
        narrowest, widest: gap [m] between the pads of the shut and the open gripper;
            `widest` is `WIDE` for grippers that open further.
        qpos: [nq], the pose before a reset's randomisation.
        joint_range: [K, n, 2] rad, the limits of the arms' joints.
        finger_qpos, finger_dof: [K, m] entries of qpos and qvel of the finger joints.
        slots: readings that are entries of MjData.
        fields: where model fields lie in the stock model.
        touches: contacts that are flagged or counted.
        memory: name -> length of the numbers that a task stores in an episode.
    """

    robots: tuple[Robot, ...]
    narrowest: float
    widest: float
    qpos: Array
    joint_range: Array
    finger_qpos: Array
    finger_dof: Array
    slots: tuple[Slot, ...]
    fields: tuple[Slot, ...]
    touches: tuple[Touch, ...]
    memory: Mapping[str, int]

    @property
    def action_dim(self) -> int:
        """Length of an action: for each robot the arm's part, then one number for the
        gripper.
        """
        arm, gripper = self.robots[0]
        one = len(arm.scale) + bool(len(gripper.actuator))
        return len(self.robots) * one

    @property
    def joint_qpos(self) -> Array:
        """[K n] entries of qpos of the joints of all arms."""
        return np.concatenate([robot.arm.qpos for robot in self.robots])

    def only_robot(self, feature: str) -> Robot:
        """The robot, for a feature that is limited to one.

        Raises:
            UserError: there are two.
        """
        if len(self.robots) > 1:
            raise UserError(
                f"{feature} does not support {len(self.robots)} robots: choose a task "
                "of one robot"
            )
        return self.robots[0]


def read_scene_layout(stock: Any, sensors: Sensors) -> SceneLayout:
    """Read the layout of a stock environment.

    Raises:
        UserError: a sensor names something that the environment's model lacks.
    """
    model, robots = stock.sim.model._model, stock.robots
    joints = [robot._ref_arm_joint_indexes for robot in robots]
    return SceneLayout(
        robots=read_robots(stock),
        narrowest=NARROWEST.get(hand_kind(robots[0]), 0.0),
        widest=WIDEST.get(hand_kind(robots[0]), WIDE),
        qpos=default_qpos(stock),
        joint_range=model.jnt_range[np.array(joints)],
        finger_qpos=np.array([finger_indices(robot, "pos") for robot in robots]),
        finger_dof=np.array([finger_indices(robot, "vel") for robot in robots]),
        slots=(*robot_slots(stock), *task_slots(model, sensors)),
        fields=field_slots(model, sensors.fields),
        touches=(
            *read_touches(stock, sensors.touches, limit=1.0),
            *read_touches(stock, sensors.counts, limit=np.inf),
        ),
        memory=sensors.memory,
    )


def with_joints(layout: SceneLayout, named: dict[str, Array]) -> dict[str, Array]:
    """Add the readings that are computed from others: joints, fingers, grippers."""
    for number, (arm, gripper) in enumerate(layout.robots):
        prefix, fingers = reading_prefix(number), len(gripper.actuator)
        own = slice(fingers * number, fingers * (number + 1))
        command = named["gripper_command"][:, own]
        named |= {
            f"{prefix}joint_pos": named["qpos"][:, arm.qpos],
            f"{prefix}joint_vel": named["qvel"][:, arm.dof],
            f"{prefix}gripper_qpos": named["qpos"][:, layout.finger_qpos[number]],
            f"{prefix}gripper_qvel": named["qvel"][:, layout.finger_dof[number]],
            f"{prefix}gripper_closing": _closing(gripper, command),
        }
    return named


def constant_readings(layout: SceneLayout) -> dict[str, Array]:
    """The readings that never change: of the joints, and properties of the gripper."""
    speed = layout.robots[0].gripper.speed
    named = {
        "gripper_speed": np.abs(speed).max(initial=0, keepdims=True),
        "gripper_narrowest": np.array([layout.narrowest]),
        "gripper_widest": np.array([layout.widest]),
    }
    for number, (arm, _) in enumerate(layout.robots):
        prefix, limits = reading_prefix(number), layout.joint_range[number]
        named[f"{prefix}rest_pos"] = layout.qpos[arm.qpos][None]
        named[f"{prefix}joint_low"], named[f"{prefix}joint_high"] = limits.T[:, None]
    return named


def _closing(gripper: Gripper, command: Array) -> Array:
    """[N] in [-1, 1]: mean command of the fingers in the direction that closes them."""
    fingers = max(1, len(gripper.speed))
    return (command * constant(np.sign(gripper.speed), command)).sum(1) / fingers
