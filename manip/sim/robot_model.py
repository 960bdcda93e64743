"""Read the indices and gains of robots from their robosuite environment."""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from manip.sim.names import lookup

Array = np.ndarray

NARROWEST = {"Robotiq85Gripper": 0.052}
"""Gap [m] between the pads of a shut gripper, where the fingers' links collide before
the pads touch (measured, 51 to 56 mm)."""

WIDEST = {"RethinkGripper": 0.06}
"""Gap [m] between the pads of an open gripper (measured), if it is less than `WIDE`."""

WIDE = 0.079
"""Gap [m] between the pads of the open Panda's; those of other arms open further."""


class Arm(NamedTuple):
    """The arm's indices and gains for the compiled control laws.

    Attributes:
        osc: whether an action moves the tool (else the joints).
        qpos, dof, actuator: [n] indices of the joints and motors.
        low, high: [n] N m, the motors' limits.
        mass: [n, n], index in `MjData.M` of each entry of the arm's mass matrix.
        scale: m or rad, the motion that an action of 1 commands: [6] for OSC_POSE, [3]
            for OSC_POSITION, [n] for JOINT_POSITION.
        kp, kd: gains [1/s^2], [1/s] of the controller.
        tool, base: grip site and base site.
        root: root body of the arm, about which MuJoCo states its joint axes.
        moves_base: [n] bool, whether the joint also moves the base site.
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
    """The gripper's law: command += speed * sign(action), clipped to [-1, 1].

    ctrl[actuator] = bias + weight * command; arrays have one entry for each actuator.
    """

    actuator: Array
    speed: Array
    bias: Array
    weight: Array


class Robot(NamedTuple):
    """What the compiled control laws need of a robot: an arm with a gripper."""

    arm: Arm
    gripper: Gripper


def reading_prefix(number: int) -> str:
    """What the names of a robot's readings begin with: nothing for the first robot,
    robot1_ for the second.
    """
    return f"robot{number}_" if number else ""


def hand_kind(robot: Any) -> str:
    """robosuite's name of a robot's gripper, such as PandaGripper."""
    return type(robot.gripper["right"]).__name__


def read_robots(stock: Any) -> tuple[Robot, ...]:
    """Read the robots of a robosuite environment, which are of one kind."""
    model = stock.sim.model._model
    return tuple(
        Robot(_read_arm(model, robot), _read_gripper(model, robot))
        for robot in stock.robots
    )


def _read_arm(model: mujoco.MjModel, robot: Any) -> Arm:
    part = robot.part_controllers["right"]
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
    dofs: list[int] = []
    while body > 0:
        start = model.body_dofadr[body]
        dofs += range(start, start + model.body_dofnum[body])
        body = model.body_parentid[body]
    return dofs


def _mass_addresses(model: mujoco.MjModel, dof: Array) -> Array:
    """Index in MjData.M (lower triangle, sparse rows) of M[dof[i], dof[j]]."""
    table = np.full((model.nv, model.nv), -1)
    for row in range(model.nv):
        start = model.M_rowadr[row]
        entries = np.arange(start, start + model.M_rownnz[row])
        table[row, model.M_colind[entries]] = entries
    return np.maximum(table, table.T)[np.ix_(dof, dof)]


def _read_gripper(model: mujoco.MjModel, robot: Any) -> Gripper:
    """Measure the gripper's law on robosuite's object: close once from command 0."""
    hand = robot.gripper["right"]
    actuator = _indices(robot._ref_joint_gripper_actuator_indexes)
    low, high = model.actuator_ctrlrange[actuator].T
    before = hand.current_action
    hand.current_action = np.zeros(hand.dof)
    speed = np.broadcast_to(hand.format_action(np.ones(1)), actuator.shape).copy()
    hand.current_action = before
    return Gripper(actuator, speed, (high + low) / 2, (high - low) / 2)


def default_qpos(stock: Any) -> Array:
    """The pose [nq] that robosuite's reset randomises."""
    qpos = stock.sim.model._model.qpos0.copy()
    for robot in stock.robots:
        qpos[np.array(robot._ref_joint_pos_indexes)] = robot.init_qpos
        fingers = finger_indices(robot, "pos")
        if len(fingers):
            qpos[fingers] = robot.gripper["right"].init_qpos
    return qpos


def finger_indices(robot: Any, kind: str) -> Array:
    """Indices of a robot's finger joints in qpos (kind "pos") or qvel ("vel")."""
    return _indices(getattr(robot, f"_ref_gripper_joint_{kind}_indexes"))


def _indices(of_arm: Any) -> Array:
    """The right arm's indices; robosuite has None for an arm without a gripper."""
    return np.array(of_arm["right"] or [], dtype=int)
