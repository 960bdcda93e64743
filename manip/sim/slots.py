"""Slots: where named readings lie in the arrays of MuJoCo."""

from collections.abc import Mapping
from itertools import chain
from typing import Any, NamedTuple

import mujoco
import numpy as np

from manip.sim.names import lookup
from manip.sim.robot_model import reading_prefix
from manip.sim.sensors import Sensors


class Slot(NamedTuple):
    """A named range of entries in a flattened array of MjData or MjModel."""

    name: str
    array: str
    start: int
    size: int


def robot_slots(stock: Any) -> tuple[Slot, ...]:
    """Slots of every task: whole state, poses of grip sites, rotations of hands."""
    model = stock.sim.model._model
    hands = (_hand_slots(model, *each) for each in enumerate(stock.robots))
    return (
        Slot("qpos", "qpos", 0, model.nq),
        Slot("qvel", "qvel", 0, model.nv),
        Slot("qacc", "qacc", 0, model.nv),
        *chain.from_iterable(hands),
    )


def _hand_slots(
    model: mujoco.MjModel, number: int, robot: Any
) -> tuple[Slot, Slot, Slot]:
    tool = lookup(model, "site", robot.gripper["right"].important_sites["grip_site"])
    hand = lookup(model, "body", robot.robot_model.eef_name["right"])
    prefix = reading_prefix(number)
    return (
        Slot(f"{prefix}eef_pos", "site_xpos", 3 * tool, 3),
        Slot(f"{prefix}eef_mat", "site_xmat", 9 * tool, 9),
        Slot(f"{prefix}hand_quat", "xquat", 4 * hand, 4),
    )


def task_slots(model: mujoco.MjModel, sensors: Sensors) -> list[Slot]:
    """Slots of the bodies, sites and joints that a task reads."""
    slots = []
    for name, body in sensors.bodies.items():
        slots += _body_slots(model, name, lookup(model, "body", body))
    for name, site in sensors.sites.items():
        slots.append(
            Slot(f"{name}_pos", "site_xpos", 3 * lookup(model, "site", site), 3)
        )
    for name, joint in sensors.joints.items():
        slots += _joint_slots(model, name, lookup(model, "joint", joint))
    return slots


def _body_slots(model: mujoco.MjModel, name: str, body: int) -> list[Slot]:
    slots = [
        Slot(f"{name}_pos", "xpos", 3 * body, 3),
        Slot(f"{name}_quat", "xquat", 4 * body, 4),
    ]
    joint = model.body_jntadr[body]
    if joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
        dof = int(model.jnt_dofadr[joint])
        slots.append(Slot(f"{name}_linvel", "qvel", dof, 3))
        slots.append(Slot(f"{name}_angvel", "qvel", dof + 3, 3))
    return slots


def force_slots(model: mujoco.MjModel, forces: Mapping[str, str]) -> tuple[Slot, ...]:
    """Slots of the force sensors, name -> site; each site has one in the model."""
    of_kind = model.sensor_type == mujoco.mjtSensor.mjSENS_FORCE
    slots = []
    for name, site in forces.items():
        at_site = model.sensor_objid == lookup(model, "site", site)
        (sensor,) = np.flatnonzero(of_kind & at_site)
        slots.append(Slot(name, "sensordata", int(model.sensor_adr[sensor]), 3))
    return tuple(slots)


def _joint_slots(model: mujoco.MjModel, name: str, joint: int) -> list[Slot]:
    return [
        Slot(f"{name}_qpos", "qpos", int(model.jnt_qposadr[joint]), 1),
        Slot(f"{name}_qvel", "qvel", int(model.jnt_dofadr[joint]), 1),
    ]
