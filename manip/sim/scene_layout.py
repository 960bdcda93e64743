"""SceneLayout: indices, names and gains of a robosuite environment.

They are read from the environment's own objects, so that every arm, gripper and task
of robosuite works, on the batch engine and in stock robosuite.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from manip.arrays import constant
from manip.sim.fields import field_slots
from manip.sim.robot_model import (
    NARROWEST,
    Arm,
    Gripper,
    default_qpos,
    finger_indices,
    hand_kind,
    read_arm,
    read_gripper,
)
from manip.sim.sensors import Sensors
from manip.sim.slots import Slot, robot_slots, task_slots
from manip.sim.touches import Touch, read_touches

Array = np.ndarray


@dataclass(frozen=True)
class SceneLayout:
    """Indices and gains of a robosuite environment's robot, and a task's sensors.

    Attributes:
        narrowest: gap [m] between the pads of the shut gripper.
        qpos: [nq], the pose before a reset's randomisation.
        joint_range: [n, 2] rad, the limits of the arm's joints.
        finger_qpos, finger_dof: entries of qpos and qvel of the finger joints.
        slots: readings that are entries of MjData.
        fields: where model fields lie in the stock model.
        touches: contacts that are flagged or counted.
        memory: name -> length of the numbers that a task stores in an episode.
    """

    arm: Arm
    gripper: Gripper
    narrowest: float
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
        """Length of an action: the arm's part, then one number for the gripper."""
        return len(self.arm.scale) + bool(len(self.gripper.actuator))


def read_scene_layout(stock: Any, sensors: Sensors) -> SceneLayout:
    """Read the layout of a stock environment.

    Raises:
        UserError: a sensor names something that the environment's model lacks.
    """
    model, robot = stock.sim.model._model, stock.robots[0]
    return SceneLayout(
        arm=read_arm(stock),
        gripper=read_gripper(stock),
        narrowest=NARROWEST.get(hand_kind(stock), 0.0),
        qpos=default_qpos(stock),
        joint_range=model.jnt_range[robot._ref_arm_joint_indexes].copy(),
        finger_qpos=finger_indices(robot, "pos"),
        finger_dof=finger_indices(robot, "vel"),
        slots=(*robot_slots(stock), *task_slots(model, sensors)),
        fields=field_slots(model, sensors.fields),
        touches=(
            *read_touches(stock, sensors.touches, limit=1.0),
            *read_touches(stock, sensors.counts, limit=np.inf),
        ),
        memory=sensors.memory,
    )


def with_joints(layout: SceneLayout, named: dict[str, Array]) -> dict[str, Array]:
    """Add the readings that are computed from others: joints, fingers, gripper."""
    named["joint_pos"] = named["qpos"][:, layout.arm.qpos]
    named["joint_vel"] = named["qvel"][:, layout.arm.dof]
    named["gripper_qpos"] = named["qpos"][:, layout.finger_qpos]
    named["gripper_qvel"] = named["qvel"][:, layout.finger_dof]
    named["gripper_closing"] = _closing(layout.gripper, named["gripper_command"])
    return named


def constant_readings(layout: SceneLayout) -> dict[str, Array]:
    """The readings that never change: limits and default pose, gripper's properties."""
    low, high = layout.joint_range.T[:, None]
    return {
        "gripper_speed": np.abs(layout.gripper.speed).max(initial=0, keepdims=True),
        "gripper_narrowest": np.array([layout.narrowest]),
        "rest_pos": layout.qpos[layout.arm.qpos][None],
        "joint_low": low,
        "joint_high": high,
    }


def _closing(gripper: Gripper, command: Array) -> Array:
    """[N] in [-1, 1]: mean command of the fingers in the direction that closes them."""
    fingers = max(1, len(gripper.speed))
    return (command * constant(np.sign(gripper.speed), command)).sum(1) / fingers
