"""Where things lie in a robosuite environment: indices, names, gains.

Read off the environment's own objects, so that any arm, gripper and task of robosuite
works alike, natively and in stock.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

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
from manip.sim.slots import Slot, field_slot, robot_slots, task_slots
from manip.sim.touches import Touch, read_touches

Array = np.ndarray


@dataclass(frozen=True)
class SceneLayout:
    """Indices and gains of a robosuite environment's robot, and a task's sensors.

    qpos [nq] is the pose before a reset's randomisation; finger_qpos and finger_dof
    index it and qvel; joint_range [n, 2] is the arm's; narrowest [m] is the gap between
    the pads of the shut gripper. `slots` are read from MjData, `fields` set in MjModel,
    `memory` kept.
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
    """SceneLayout of a stock environment.

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
        fields=tuple(
            field_slot(model, name, *at) for name, at in sensors.fields.items()
        ),
        touches=(
            *read_touches(stock, sensors.touches, most=1.0),
            *read_touches(stock, sensors.counts, most=np.inf),
        ),
        memory=sensors.memory,
    )


def with_joints(layout: SceneLayout, named: dict[str, Array]) -> dict[str, Array]:
    """Add the readings that index others: the arm's joints and the fingers'."""
    named["joint_pos"] = named["qpos"][:, layout.arm.qpos]
    named["joint_vel"] = named["qvel"][:, layout.arm.dof]
    named["gripper_qpos"] = named["qpos"][:, layout.finger_qpos]
    named["gripper_qvel"] = named["qvel"][:, layout.finger_dof]
    named["gripper_closing"] = _closing(layout.gripper, named["gripper_command"])
    named["gripper_speed"] = np.abs(layout.gripper.speed).max(initial=0, keepdims=True)
    named["gripper_narrowest"] = np.array([layout.narrowest])
    named["rest_pos"] = layout.qpos[layout.arm.qpos][None]
    named["joint_low"], named["joint_high"] = layout.joint_range.T[:, None]
    return named


def _closing(gripper: Gripper, command: Array) -> Array:
    """[N] in [-1, 1]: the command of all fingers in the direction that closes them."""
    fingers = max(1, len(gripper.speed))
    return (command * np.sign(gripper.speed)).sum(1) / fingers
