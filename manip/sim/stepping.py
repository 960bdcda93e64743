"""The compiled loop of the batch engine: one control period of some worlds.

A control period is robosuite's own sequence (environments/base.py): `mj_step1`, goal
latched at the first substep, control law, `mj_step2`.
"""

from math import isfinite, isnan, sqrt
from typing import NamedTuple

import numpy as np

from manip.compiled import jit, kernel
from manip.sim.atomic_counter import take_number
from manip.sim.control_laws import (
    NULL_KP,
    Work,
    joint_torque,
    latch_pose_goal,
    osc_torque,
    pose_error,
)
from manip.sim.libmujoco import mj_forward, mj_step1, mj_step2, mju_copy
from manip.sim.robot_model import Arm, Gripper

Array = np.ndarray

LIMIT = 1e8
"""A world whose |qpos| or |qvel| passes this is counted as broken (MuJoCo: 1e10)."""


class Places(NamedTuple):
    """Where the entries of a row come from, run after run: addresses and lengths."""

    address: Array
    size: Array


class Sim(NamedTuple):
    """A thread's own MjModel and MjData as addresses, and views of their arrays.

    state: all that a world's state row holds; slots: what its readings row holds
    before the contact flags. command: of the gripper, an entry an actuator.
    """

    model: int
    data: int
    state: Places
    slots: Places
    command: Array
    qpos: Array
    qvel: Array
    ctrl: Array
    mass: Array
    bias: Array
    cdof: Array
    com: Array
    site_xpos: Array
    site_xmat: Array
    found: Array


class Plan(NamedTuple):
    """What a control period is: its substeps, and whose number a touch sensor adds to.

    most [K]: the largest number of each touch, 1 for a flag.
    """

    substeps: int
    touch_at: int
    touch_of_sensor: Array
    most: Array


@kernel
def load(row: Array, places: Places) -> None:
    """Put a row where its entries belong."""
    at = row.ctypes.data
    for k in range(len(places.size)):
        mju_copy(places.address[k], at, np.int32(places.size[k]))
        at += 8 * places.size[k]


@kernel
def _store(row: Array, places: Places) -> None:
    at = row.ctypes.data
    for k in range(len(places.size)):
        mju_copy(at, places.address[k], np.int32(places.size[k]))
        at += 8 * places.size[k]


@kernel
def _store_touches(row: Array, plan: Plan, found: Array) -> None:
    for k in range(plan.touch_at, len(row)):
        row[k] = 0.0
    for k in range(len(plan.touch_of_sensor)):
        touch = plan.touch_of_sensor[k]
        contacts = row[plan.touch_at + touch] + found[k]
        row[plan.touch_at + touch] = min(plan.most[touch], contacts)


@kernel
def _within_limits(values: Array) -> bool:
    for i in range(len(values)):
        if not abs(values[i]) < LIMIT:
            return False
    return True


@kernel
def _read_joints(sim: Sim, arm: Arm, w: Work) -> None:
    for i in range(len(w.q)):
        w.q[i] = sim.qpos[arm.qpos[i]]
        w.qd[i] = sim.qvel[arm.dof[i]]
        w.bias[i] = sim.bias[arm.dof[i]]
        for j in range(len(w.q)):
            w.mass[i, j] = sim.mass[arm.mass[i, j]]


@kernel
def _read_pose(sim: Sim, site: int, p: Array, r: Array) -> None:
    for i in range(3):
        p[i] = sim.site_xpos[site, i]
        for j in range(3):
            r[i, j] = sim.site_xmat[site, 3 * i + j]


@kernel
def _read_jacobian(sim: Sim, arm: Arm, w: Work) -> None:
    """J from the joints' axes, which MuJoCo keeps about `com` (engine_core_util.c)."""
    for k in range(len(w.q)):
        axis = sim.cdof[arm.dof[k]]
        for i in range(3):
            u, v = (i + 1) % 3, (i + 2) % 3
            to_u = w.tool_p[u] - sim.com[arm.root, u]
            to_v = w.tool_p[v] - sim.com[arm.root, v]
            w.jac[i, k] = axis[3 + i] + (axis[u] * to_v - axis[v] * to_u)
            w.jac[3 + i, k] = axis[i]


@kernel
def _read_velocity(arm: Arm, w: Work) -> None:
    """Of the tool, less the base site's: a joint below both only turns one about it."""
    for i in range(3):
        u, v = (i + 1) % 3, (i + 2) % 3
        w.velocity[i] = w.velocity[3 + i] = 0.0
        for k in range(len(w.q)):
            if arm.moves_base[k]:
                turn_u = w.jac[3 + u, k] * (w.tool_p[v] - w.base_p[v])
                turn_v = w.jac[3 + v, k] * (w.tool_p[u] - w.base_p[u])
                w.velocity[i] += (turn_u - turn_v) * w.qd[k]
            else:
                w.velocity[i] += w.jac[i, k] * w.qd[k]
                w.velocity[3 + i] += w.jac[3 + i, k] * w.qd[k]


@kernel
def _read_arm(sim: Sim, arm: Arm, w: Work) -> None:
    _read_joints(sim, arm, w)
    if arm.osc:
        _read_pose(sim, arm.tool, w.tool_p, w.tool_r)
        _read_pose(sim, arm.base, w.base_p, w.base_r)
        _read_jacobian(sim, arm, w)
        _read_velocity(arm, w)


@kernel
def _latch(arm: Arm, w: Work, action: Array) -> None:
    if arm.osc:
        latch_pose_goal(action, arm.scale, w)
        return
    for i in range(len(w.q)):
        w.goal_q[i] = w.q[i] + arm.scale[i] * min(1.0, max(-1.0, action[i]))


@kernel
def _arm_torque(arm: Arm, w: Work) -> None:
    if arm.osc:
        for i in range(len(w.q)):
            w.pull[i] = NULL_KP * (w.q0[i] - w.q[i])
            w.pull[i] -= 2.0 * sqrt(NULL_KP) * w.qd[i]
        pose_error(arm.kp, arm.kd, w)
        osc_torque(w)
        return
    for i in range(len(w.q)):
        w.pull[i] = arm.kp * (w.goal_q[i] - w.q[i]) - arm.kd * w.qd[i]
    joint_torque(w)


@kernel
def _drive_arm(sim: Sim, arm: Arm, w: Work) -> bool:
    """Clip the torque to the actuators' range and apply it; False if not finite."""
    finite = True
    for i in range(len(w.torque)):
        finite = finite and isfinite(w.torque[i])
        sim.ctrl[arm.actuator[i]] = min(arm.high[i], max(arm.low[i], w.torque[i]))
    return finite


@kernel
def _drive_gripper(sim: Sim, gripper: Gripper, action: float) -> None:
    sign = np.sign(action)
    for i in range(len(gripper.actuator)):
        moved = sim.command[i] + gripper.speed[i] * sign
        sim.command[i] = min(1.0, max(-1.0, moved))
        sim.ctrl[gripper.actuator[i]] = (
            gripper.bias[i] + gripper.weight[i] * sim.command[i]
        )


@kernel
def control(
    sim: Sim, arm: Arm, gripper: Gripper, w: Work, action: Array, substep: int
) -> bool:
    """Set ctrl between `mj_step1` and `mj_step2`; False if it would not be finite."""
    _read_arm(sim, arm, w)
    if substep == 0:
        _latch(arm, w, action)
        _drive_gripper(sim, gripper, action[-1])
    _arm_torque(arm, w)
    return _drive_arm(sim, arm, w)


@kernel
def _advance(
    sim: Sim, plan: Plan, arm: Arm, gripper: Gripper, w: Work, action: Array
) -> bool:
    """One control period of the loaded world; False if it became non-finite."""
    for k in range(len(action)):
        if isnan(action[k]):  # the clips would make it -1: full speed
            return False
    for substep in range(plan.substeps):
        mj_step1(sim.model, sim.data)
        if not control(sim, arm, gripper, w, action, substep):
            return False
        mj_step2(sim.model, sim.data)
        if not (_within_limits(sim.qpos) and _within_limits(sim.qvel)):
            return False
    return True


@jit
def step_worlds(
    sim: Sim,
    plan: Plan,
    arm: Arm,
    gripper: Gripper,
    w: Work,
    actions: Array,
    states: Array,
    readings: Array,
    broken: Array,
    counter: Array,
) -> None:
    """Step the worlds that `counter` [1] hands out, one by one, to all who ask.

    A broken world keeps its state and its readings.
    """
    while True:
        world = take_number(counter.ctypes.data)
        if world >= len(states):
            return
        load(states[world], sim.state)
        broken[world] = not _advance(sim, plan, arm, gripper, w, actions[world])
        if not broken[world]:
            _store(states[world], sim.state)
            _store(readings[world], sim.slots)
            _store_touches(readings[world], plan, sim.found)


@jit
def refresh_worlds(
    sim: Sim,
    plan: Plan,
    states: Array,
    readings: Array,
    worlds: Array,
    counter: Array,
) -> None:
    """`mj_forward` on the given worlds, as robosuite does at the end of a reset."""
    for i in range(len(sim.ctrl)):
        sim.ctrl[i] = 0.0
    while True:
        i = take_number(counter.ctypes.data)
        if i >= len(worlds):
            return
        load(states[worlds[i]], sim.state)
        mj_forward(sim.model, sim.data)
        _store(states[worlds[i]], sim.state)
        _store(readings[worlds[i]], sim.slots)
        _store_touches(readings[worlds[i]], plan, sim.found)
