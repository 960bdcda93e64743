"""Where things lie in a robosuite environment: indices, names, gains.

Read off the environment's own objects, so that any arm, gripper and task of robosuite
works alike, natively and in stock.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import mujoco
import numpy as np

from manip.errors import unknown

Array = np.ndarray


@dataclass(frozen=True)
class Sensors:
    """What a task reads besides the arm, and what it sets, by MuJoCo names.

    bodies: name -> body; gives `<name>_pos` [3] m, `<name>_quat` [4] wxyz, and for a
        body on a free joint `<name>_linvel` [3] m/s, `<name>_angvel` [3] rad/s.
    sites: name -> site; gives `<name>_pos` [3] m.
    joints: name -> hinge or slide joint; gives `<name>_qpos` [1] and `<name>_qvel` [1]
        in rad and rad/s, or m and m/s.
    touches: name -> (side, side), a side being a geom group of the gripper (such as
        "left_fingerpad"), "arm" for the arm's links, a body with all below it ("world"
        for anything), or a geom that no body is named like; gives `<name>` [1], 1 in
        touch.
    counts: the same, but gives how many contacts there are.
    forces: name -> site; gives `<name>` [3] N, the force of the site's body on the one
        that carries it, in the site's frame.
    memory: name -> k; gives `<name>` [k], numbers that the task keeps of each world's
        episode, 0 at first (see `Task.remember`).
    fields: name -> (model array, object), such as ("site_pos", "goal"): entries of
        the model that every world has for itself and a reset may set.
    parked: bodies that the task drops out of the way; the fast fidelity does not hold
        them up.
    """

    bodies: Mapping[str, str] = field(default_factory=dict)
    sites: Mapping[str, str] = field(default_factory=dict)
    joints: Mapping[str, str] = field(default_factory=dict)
    touches: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    counts: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    forces: Mapping[str, str] = field(default_factory=dict)
    memory: Mapping[str, int] = field(default_factory=dict)
    fields: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    parked: tuple[str, ...] = ()


_PADS = {
    "XArm7Gripper": {
        f"{side}_fingerpad": [f"gripper0_right_{side}_finger_pad_{i}" for i in (1, 2)]
        for side in ("left", "right")
    }
}
"""Finger pads by their real names, where robosuite 1.5.2 names geoms that its model
lacks (models/grippers/xarm7_gripper.py); its own grasp test never fires there."""

_NARROWEST = {"Robotiq85Gripper": 0.052}
"""Gap [m] between the pads of a shut gripper, where that is too wide for small things:
the links of its fingers collide before (measured, 51 to 56 mm)."""


class Arm(NamedTuple):
    """The arm's indices and gains, as the compiled control laws need them.

    osc: whether the action moves the tool or the joints. scale [m or rad]: what a full
    action moves: [6] for OSC_POSE, [3] for OSC_POSITION, [n] for JOINT_POSITION. `mass`
    [n, n] holds the address of each entry of the arm's mass matrix in `MjData.M`.
    """

    osc: bool
    qpos: Array
    dof: Array
    actuator: Array
    low: Array
    high: Array
    mass: Array
    scale: Array
    kp: float
    kd: float
    tool: int
    base: int
    root: int
    moves_base: Array


class Gripper(NamedTuple):
    """The gripper law: command += speed * sign(a), clipped to [-1, 1], then affine.

    ctrl[actuator] = bias + weight * command; all arrays have one entry an actuator.
    """

    actuator: Array
    speed: Array
    bias: Array
    weight: Array


class Slot(NamedTuple):
    """A named run of entries in an array of MjData or MjModel."""

    name: str
    array: str
    start: int
    size: int


class Side(NamedTuple):
    """One side of a contact: geoms by name, or a body with all below it."""

    geoms: tuple[str, ...]
    body: str | None


class Touch(NamedTuple):
    """A named number of contacts between two sides, or a flag: of them, `most` 1."""

    name: str
    first: Side
    second: Side
    most: float


@dataclass(frozen=True)
class Handles:
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


def find_handles(stock: Any, sensors: Sensors) -> Handles:
    """Handles of a stock environment.

    Raises:
        UserError: a sensor names something that the environment's model lacks.
    """
    model, robot = stock.sim.model._model, stock.robots[0]
    return Handles(
        arm=_arm(stock),
        gripper=_gripper(stock),
        narrowest=_NARROWEST.get(hand_kind(stock), 0.0),
        qpos=_default_qpos(stock),
        joint_range=model.jnt_range[robot._ref_arm_joint_indexes].copy(),
        finger_qpos=_finger_indices(robot, "pos"),
        finger_dof=_finger_indices(robot, "vel"),
        slots=(*_robot_slots(stock), *_task_slots(model, sensors)),
        fields=tuple(_field(model, name, *at) for name, at in sensors.fields.items()),
        touches=(
            *_touches(stock, sensors.touches, most=1.0),
            *_touches(stock, sensors.counts, most=np.inf),
        ),
        memory=sensors.memory,
    )


def hand_kind(stock: Any) -> str:
    """robosuite's name of the robot's gripper, such as PandaGripper."""
    return type(stock.robots[0].gripper["right"]).__name__


def with_joints(handles: Handles, named: dict[str, Array]) -> dict[str, Array]:
    """Add the readings that index others: the arm's joints and the fingers'."""
    named["joint_pos"] = named["qpos"][:, handles.arm.qpos]
    named["joint_vel"] = named["qvel"][:, handles.arm.dof]
    named["gripper_qpos"] = named["qpos"][:, handles.finger_qpos]
    named["gripper_qvel"] = named["qvel"][:, handles.finger_dof]
    named["gripper_closing"] = _closing(handles.gripper, named["gripper_command"])
    named["gripper_speed"] = np.abs(handles.gripper.speed).max(initial=0, keepdims=True)
    named["gripper_narrowest"] = np.array([handles.narrowest])
    named["rest_pos"] = handles.qpos[handles.arm.qpos][None]
    named["joint_low"], named["joint_high"] = handles.joint_range.T[:, None]
    return named


def _closing(gripper: Gripper, command: Array) -> Array:
    """[N] in [-1, 1]: the command of all fingers in the direction that closes them."""
    fingers = max(1, len(gripper.speed))
    return (command * np.sign(gripper.speed)).sum(1) / fingers


def lookup(model: mujoco.MjModel, kind: str, name: str) -> int:
    """Id of a named body, site, geom, ... of the model.

    Raises:
        UserError: no such name; the message lists the names that exist.
    """
    found = _find(model, kind, name)
    if found < 0:
        count = model.njnt if kind == "joint" else getattr(model, f"n{kind}")
        known = (getattr(model, kind)(i).name for i in range(count))
        raise unknown(kind, name, filter(None, known))
    return found


def _find(model: mujoco.MjModel, kind: str, name: str) -> int:
    """Id of a named body, site, geom, ..., or -1."""
    return mujoco.mj_name2id(
        model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name
    )


def _touches(
    stock: Any, named: Mapping[str, tuple[str, str]], most: float
) -> Iterator[Touch]:
    for name, (first, second) in named.items():
        yield Touch(name, _side(stock, first), _side(stock, second), most)


def _side(stock: Any, name: str) -> Side:
    robot = stock.robots[0]
    hand = robot.gripper["right"]
    groups = hand.important_geoms | _PADS.get(hand_kind(stock), {})
    groups["arm"] = robot.robot_model.contact_geoms
    if name in groups:
        return Side(tuple(groups[name]), None)
    model = stock.sim.model._model
    if _find(model, "body", name) < 0 <= _find(model, "geom", name):
        return Side((name,), None)
    lookup(model, "body", name)
    return Side((), name)


def _arm(stock: Any) -> Arm:
    model = stock.sim.model._model
    part = stock.robots[0].part_controllers["right"]
    robot = stock.robots[0]
    actuator = np.array(robot._ref_arm_joint_actuator_indexes)
    dof = np.array(part.qvel_index)
    tool = lookup(model, "site", robot.gripper["right"].important_sites["grip_site"])
    base = lookup(model, "site", f"{part.naming_prefix}{part.part_name}_center")
    return Arm(
        osc=part.name.startswith("OSC"),
        qpos=np.array(part.qpos_index),
        dof=dof,
        actuator=actuator,
        low=model.actuator_ctrlrange[actuator, 0].copy(),
        high=model.actuator_ctrlrange[actuator, 1].copy(),
        mass=_mass_addresses(model, dof),
        scale=np.array(part.output_max, dtype=float),
        kp=float(part.kp[0]),
        kd=float(part.kd[0]),
        tool=tool,
        base=base,
        root=int(model.body_rootid[model.site_bodyid[tool]]),
        moves_base=np.isin(dof, _dofs_above(model, model.site_bodyid[base])),
    )


def _dofs_above(model: mujoco.MjModel, body: int) -> list[int]:
    """Degrees of freedom that move a body."""
    found: list[int] = []
    while body > 0:
        start = model.body_dofadr[body]
        found += range(start, start + model.body_dofnum[body])
        body = model.body_parentid[body]
    return found


def _mass_addresses(model: mujoco.MjModel, dof: Array) -> Array:
    """Address in MjData.M (lower triangle, sparse rows) of M[dof[i], dof[j]]."""
    table = np.full((model.nv, model.nv), -1)
    for row in range(model.nv):
        start = model.M_rowadr[row]
        entries = np.arange(start, start + model.M_rownnz[row])
        table[row, model.M_colind[entries]] = entries
    return np.maximum(table, table.T)[np.ix_(dof, dof)]


def _gripper(stock: Any) -> Gripper:
    """Read the gripper's law off robosuite's object by trying it: close once from 0."""
    robot = stock.robots[0]
    hand = robot.gripper["right"]
    actuator = np.array(robot._ref_joint_gripper_actuator_indexes["right"], dtype=int)
    low, high = stock.sim.model._model.actuator_ctrlrange[actuator].T
    kept = hand.current_action
    hand.current_action = np.zeros(hand.dof)
    speed = np.broadcast_to(hand.format_action(np.ones(1)), actuator.shape).copy()
    hand.current_action = kept
    return Gripper(actuator, speed, (high + low) / 2, (high - low) / 2)


def _default_qpos(stock: Any) -> Array:
    robot = stock.robots[0]
    qpos = stock.sim.model._model.qpos0.copy()
    qpos[np.array(robot._ref_joint_pos_indexes)] = robot.init_qpos
    fingers = _finger_indices(robot, "pos")
    if len(fingers):
        qpos[fingers] = robot.gripper["right"].init_qpos
    return qpos


def _finger_indices(robot: Any, kind: str) -> Array:
    indices = getattr(robot, f"_ref_gripper_joint_{kind}_indexes")["right"]
    return np.array(indices, dtype=int)


def _robot_slots(stock: Any) -> tuple[Slot, ...]:
    """The arm's readings that need no indexing: whole state, tool pose, hand body."""
    model, robot = stock.sim.model._model, stock.robots[0]
    tool = lookup(model, "site", robot.gripper["right"].important_sites["grip_site"])
    hand = lookup(model, "body", robot.robot_model.eef_name["right"])
    return (
        Slot("qpos", "qpos", 0, model.nq),
        Slot("qvel", "qvel", 0, model.nv),
        Slot("qacc", "qacc", 0, model.nv),
        Slot("eef_pos", "site_xpos", 3 * tool, 3),
        Slot("eef_mat", "site_xmat", 9 * tool, 9),
        Slot("hand_quat", "xquat", 4 * hand, 4),
    )


def _task_slots(model: mujoco.MjModel, sensors: Sensors) -> list[Slot]:
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
    """Where a model with sensors for them keeps the forces at some sites."""
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


def _field(model: mujoco.MjModel, name: str, array: str, target: str) -> Slot:
    kind = array.split("_")[0]
    known = [entry for entry in dir(model) if _holds_fields(model, entry)]
    if array not in known:
        raise unknown("model array", array, known)
    size = getattr(model, array)[0].size
    return Slot(name, array, size * lookup(model, kind, target), size)


def _holds_fields(model: mujoco.MjModel, array: str) -> bool:
    """Whether it is an array of floats with a row for each body, geom or site."""
    if not array.startswith(("body_", "geom_", "site_")):
        return False
    rows = getattr(model, array)
    return rows.dtype == np.float64 and len(rows) > 0
