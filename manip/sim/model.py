"""From a robosuite environment to what the batch engine steps.

A `Scene` holds the physics model (stock MJCF without visual geoms), the stock model
for pictures, and the indices of everything that is read, driven or set per world.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np

from manip.errors import unknown
from manip.sim.stock import PHYSICS_DT, make_stock

Array = np.ndarray
Fidelity = Literal["exact", "fast"]

FAST_DT = 0.005
"""Timestep [s] of the fast fidelity: 10 instead of 25 substeps at 20 Hz."""

ARENA_BYTES = 64 << 20
"""Memory of one MjData; robosuite reserves 1.3 GB of address space."""


@dataclass(frozen=True)
class Sensors:
    """What a task reads besides the arm, and what it sets, by MuJoCo names.

    bodies: name -> body; gives `<name>_pos` [3] m, `<name>_quat` [4] wxyz, and for a
        body on a free joint `<name>_linvel` [3] m/s, `<name>_angvel` [3] rad/s.
    sites: name -> site; gives `<name>_pos` [3] m.
    touches: name -> (side, side), a side being a geom group of the gripper (such as
        "left_fingerpad") or a body with all below it; gives `<name>` [1], 1 in touch.
    fields: name -> (model array, object), such as ("site_pos", "goal"): entries of
        the model that every world has for itself and a reset may set.
    """

    bodies: Mapping[str, str] = field(default_factory=dict)
    sites: Mapping[str, str] = field(default_factory=dict)
    touches: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    fields: Mapping[str, tuple[str, str]] = field(default_factory=dict)


class Arm(NamedTuple):
    """The arm's indices and gains, as the compiled control laws need them.

    osc: whether the action is a tool pose (OSC_POSE) or joint angles. `mass` [n, n]
    holds the address of each entry of the arm's mass matrix in `MjData.M`.
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


@dataclass(frozen=True)
class Touch:
    """A named contact flag: sensor indices natively, geom ids on both sides in stock."""

    name: str
    sensors: Array
    geoms: tuple[Array, Array]


@dataclass(frozen=True)
class Scene:
    """A robosuite task and robot, compiled: models, indices, and the default pose.

    qpos [nq] is the pose before a reset's randomisation; arm_qpos and finger_qpos
    index it. `slots` are read from MjData, `fields` set in MjModel, per world.
    """

    physics: mujoco.MjModel
    visual: mujoco.MjModel
    stock: Any
    arm: Arm
    gripper: Gripper
    substeps: int
    control_dt: float
    qpos: Array
    finger_qpos: Array
    finger_dof: Array
    slots: tuple[Slot, ...]
    fields: tuple[Slot, ...]
    touches: tuple[Touch, ...]

    @property
    def action_dim(self) -> int:
        """Length of an action: the arm's part, then one number for the gripper."""
        return len(self.arm.scale) + bool(len(self.gripper.actuator))

    def free_qpos(self, joint_body: str) -> slice:
        """Entries of qpos that place a free body: position [3] m, quaternion wxyz."""
        body = self.physics.body(joint_body)
        start = int(self.physics.jnt_qposadr[body.jntadr[0]])
        return slice(start, start + 7)


def build_scene(
    stock: Any, sensors: Sensors, control_freq: int = 20, fidelity: Fidelity = "exact"
) -> Scene:
    """Compile the scene of a stock environment made by `make_stock`.

    fidelity: "exact" is robosuite's own physics (2 ms); "fast" takes 5 ms steps and
        leaves out the collisions of the arm's links, for training and sweeps.
    """
    visual = stock.sim.model._model
    dt = FAST_DT if fidelity == "fast" else PHYSICS_DT
    physics, touches = _physics(stock, sensors, fidelity, dt)
    robot = stock.robots[0]
    slots = (*_robot_slots(stock), *_task_slots(visual, sensors))
    return Scene(
        physics=physics,
        visual=visual,
        stock=stock,
        arm=_arm(stock, physics),
        gripper=_gripper(stock),
        substeps=round(1 / control_freq / dt),
        control_dt=1 / control_freq,
        qpos=_default_qpos(stock),
        finger_qpos=_finger_indices(robot, "pos"),
        finger_dof=_finger_indices(robot, "vel"),
        slots=slots,
        fields=tuple(_field(visual, name, *at) for name, at in sensors.fields.items()),
        touches=touches,
    )


def load_scene(
    name: str,
    sensors: Sensors,
    robot: str = "Panda",
    controller: str = "OSC_POSE",
    control_freq: int = 20,
    fidelity: Fidelity = "exact",
    seed: int | None = 0,
) -> Scene:
    """Build the stock environment `name` and its scene.

    seed: fixes what robosuite samples at construction (Lift's cube size).
    """
    stock = make_stock(name, robot, controller, control_freq, seed)
    return build_scene(stock, sensors, control_freq, fidelity)


def stock_reader(stock: Any, sensors: Sensors) -> Callable[[], dict[str, Array]]:
    """A function that reads a stock environment as `BatchEngine.read` reads worlds.

    Returns:
        A function that gives the same names, for one world: arrays [1, k].
    """
    scene = build_scene(stock, sensors)
    data = stock.sim.data._data
    hand = stock.robots[0].gripper["right"]
    part = stock.robots[0].part_controllers

    def read() -> dict[str, Array]:
        named = {slot.name: _slot_values(data, slot)[None] for slot in scene.slots}
        for slot in scene.fields:
            named[slot.name] = _slot_values(scene.visual, slot)[None]
        for touch in scene.touches:
            named[touch.name] = np.array([float(_in_touch(data, *touch.geoms))])
        command = np.broadcast_to(hand.current_action, scene.gripper.speed.shape)
        named["gripper_command"] = command[None].copy()
        named["start_pos"] = np.array(part["right"].initial_joint)[None]
        return with_joints(scene, named)

    return read


def with_joints(scene: Scene, named: dict[str, Array]) -> dict[str, Array]:
    """Add the readings that index others: the arm's joints and the fingers'."""
    named["joint_pos"] = named["qpos"][:, scene.arm.qpos]
    named["joint_vel"] = named["qvel"][:, scene.arm.dof]
    named["gripper_qpos"] = named["qpos"][:, scene.finger_qpos]
    named["gripper_qvel"] = named["qvel"][:, scene.finger_dof]
    named["rest_pos"] = scene.qpos[scene.arm.qpos][None]
    return named


def _slot_values(owner: Any, slot: Slot) -> Array:
    return getattr(owner, slot.array).ravel()[slot.start : slot.start + slot.size].copy()


def _in_touch(data: mujoco.MjData, first: Array, second: Array) -> bool:
    a, b = data.contact.geom.T
    pairs = (np.isin(a, first) & np.isin(b, second)) | (
        np.isin(b, first) & np.isin(a, second)
    )
    return bool(pairs.any())


def lookup(model: mujoco.MjModel, kind: str, name: str) -> int:
    """Id of a named body, site, geom, ... of the model.

    Raises:
        UserError: no such name; the message lists the names that exist.
    """
    found = mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name)
    if found < 0:
        count = getattr(model, f"n{kind}")
        known = (getattr(model, kind)(i).name for i in range(count))
        raise unknown(kind, name, filter(None, known))
    return found


def _physics(
    stock: Any, sensors: Sensors, fidelity: Fidelity, dt: float
) -> tuple[mujoco.MjModel, tuple[Touch, ...]]:
    spec = mujoco.MjSpec.from_string(stock.model.get_xml())
    spec.option.timestep = dt
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    spec.memory = ARENA_BYTES
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    _strip(spec, stock, fidelity)
    visual = stock.sim.model._model
    touches = []
    for name, sides in sensors.touches.items():
        first, second = (_side(stock, side) for side in sides)
        start = len(spec.sensors)
        _add_touch_sensors(spec, name, first, second)
        geoms = (_geom_ids(visual, first), _geom_ids(visual, second))
        touches.append(Touch(name, np.arange(start, len(spec.sensors)), geoms))
    return spec.compile(), tuple(touches)


def _strip(spec: mujoco.MjSpec, stock: Any, fidelity: Fidelity) -> None:
    """Delete what cannot touch anything, and what only such geoms used."""
    prefix = stock.robots[0].robot_model.naming_prefix
    for geom in list(spec.geoms):
        of_arm = geom.parent.name.startswith(prefix)
        collides = geom.contype or geom.conaffinity
        if not collides or (fidelity == "fast" and of_arm):
            spec.delete(geom)
    for geom in spec.geoms:
        geom.material = ""
    for site in spec.sites:
        site.material = ""
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)
    for part in (*spec.materials, *spec.textures):
        spec.delete(part)


class _Side(NamedTuple):
    geoms: tuple[str, ...]
    body: str | None


def _side(stock: Any, name: str) -> _Side:
    groups = stock.robots[0].gripper["right"].important_geoms
    if name in groups:
        return _Side(tuple(groups[name]), None)
    lookup(stock.sim.model._model, "body", name)
    return _Side((), name)


def _add_touch_sensors(
    spec: mujoco.MjSpec, name: str, first: _Side, second: _Side
) -> None:
    """A contact sensor a pair; its reading is the number of contacts found."""
    geom, subtree = mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_XBODY
    for a in first.geoms or (first.body,):
        for b in second.geoms or (second.body,):
            spec.add_sensor(
                name=f"{name}/{a}/{b}",
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=geom if first.geoms else subtree,
                objname=a,
                reftype=geom if second.geoms else subtree,
                refname=b,
                intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1],
            )


def _geom_ids(model: mujoco.MjModel, side: _Side) -> Array:
    if side.geoms:
        return np.array([lookup(model, "geom", name) for name in side.geoms])
    root = lookup(model, "body", side.body or "")
    inside = [root]
    for body in range(root + 1, model.nbody):
        if model.body_parentid[body] in inside:
            inside.append(body)
    return np.flatnonzero(np.isin(model.geom_bodyid, inside))


def _arm(stock: Any, physics: mujoco.MjModel) -> Arm:
    part = stock.robots[0].part_controllers["right"]
    robot = stock.robots[0]
    actuator = np.array(robot._ref_arm_joint_actuator_indexes)
    dof = np.array(part.qvel_index)
    base = f"{part.naming_prefix}{part.part_name}_center"
    return Arm(
        osc=part.name == "OSC_POSE",
        qpos=np.array(part.qpos_index),
        dof=dof,
        actuator=actuator,
        low=physics.actuator_ctrlrange[actuator, 0].copy(),
        high=physics.actuator_ctrlrange[actuator, 1].copy(),
        mass=_mass_addresses(physics, dof),
        scale=np.array(part.output_max, dtype=float),
        kp=float(part.kp[0]),
        kd=float(part.kd[0]),
        tool=lookup(physics, "site", robot.gripper["right"].important_sites["grip_site"]),
        base=lookup(physics, "site", base),
    )


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
    qpos[_finger_indices(robot, "pos")] = robot.gripper["right"].init_qpos
    return qpos


def _finger_indices(robot: Any, kind: str) -> Array:
    return np.array(getattr(robot, f"_ref_gripper_joint_{kind}_indexes")["right"])


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
        slots.append(Slot(f"{name}_pos", "site_xpos", 3 * lookup(model, "site", site), 3))
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


def _field(model: mujoco.MjModel, name: str, array: str, target: str) -> Slot:
    kind = array.split("_")[0]
    rows = getattr(model, array)
    size = rows[0].size
    return Slot(name, array, size * lookup(model, kind, target), size)
