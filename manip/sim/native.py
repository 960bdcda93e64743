"""The compiled loop of the batch engine: one control period of some worlds.

A control period is robosuite's own sequence (environments/base.py): `mj_step1`, goal
latched at the first substep, control law, `mj_step2`.
"""

from typing import NamedTuple

import numpy as np

from manip.compiled import jit
from manip.sim.control import (
    NULL_KP,
    joint_torque,
    latch_pose_goal,
    osc_torque,
    pose_error,
)
from manip.sim.handles import Arm, Gripper
from manip.sim.libmujoco import (
    mj_forward,
    mj_jac_site,
    mj_step1,
    mj_step2,
    mju_copy,
)

Array = np.ndarray

LIMIT = 1e8
"""A world whose |qpos| or |qvel| passes this is counted as broken (MuJoCo: 1e10)."""


class Work(NamedTuple):
    """Scratch of the control law, one a thread."""

    mass: Array
    mass_factor: Array
    jac: Array
    jac_full: Array
    x: Array
    inertia: Array
    linear: Array
    angular: Array
    task: Array
    wrench: Array
    velocity: Array
    pull: Array
    bias: Array
    torque: Array
    goal_p: Array
    goal_r: Array
    turn: Array
    goal_q: Array


class Sim(NamedTuple):
    """A thread's own MjModel and MjData as addresses, and views of their arrays."""

    model: int
    data: int
    qpos: Array
    qvel: Array
    warmstart: Array
    ctrl: Array
    mass: Array
    bias: Array
    site_xpos: Array
    site_xmat: Array
    found: Array
    sources: Array
    targets: Array


class Plan(NamedTuple):
    """Where things lie: in a world's state row, in its readings row."""

    nq: int
    nv: int
    slot_sizes: Array
    field_sizes: Array
    touch_start: int
    touch_of_sensor: Array
    substeps: int


@jit
def _load(sim: Sim, plan: Plan, fields_at: int, row: Array) -> None:
    nq, nv = plan.nq, plan.nv
    sim.qpos[:] = row[:nq]
    sim.qvel[:] = row[nq : nq + nv]
    sim.warmstart[:] = row[nq + nv : nq + 2 * nv]
    at = fields_at
    for k in range(len(plan.field_sizes)):
        mju_copy(sim.targets[k], row[at:].ctypes.data, np.int32(plan.field_sizes[k]))
        at += plan.field_sizes[k]


@jit
def _store(sim: Sim, plan: Plan, row: Array) -> None:
    nq, nv = plan.nq, plan.nv
    row[:nq] = sim.qpos
    row[nq : nq + nv] = sim.qvel
    row[nq + nv : nq + 2 * nv] = sim.warmstart


@jit
def _gather(sim: Sim, plan: Plan, row: Array) -> None:
    at = 0
    for k in range(len(plan.slot_sizes)):
        mju_copy(row[at:].ctypes.data, sim.sources[k], np.int32(plan.slot_sizes[k]))
        at += plan.slot_sizes[k]
    row[plan.touch_start :] = 0.0
    for k in range(len(plan.touch_of_sensor)):
        if sim.found[k] > 0.0:
            row[plan.touch_start + plan.touch_of_sensor[k]] = 1.0


@jit
def _broken(sim: Sim) -> bool:
    for x in sim.qpos:
        if not abs(x) < LIMIT:
            return True
    for x in sim.qvel:
        if not abs(x) < LIMIT:
            return True
    return False


@jit
def _latch(sim: Sim, arm: Arm, work: Work, action: Array) -> None:
    if arm.osc:
        latch_pose_goal(
            action,
            arm.scale,
            sim.site_xpos[arm.tool],
            sim.site_xmat[arm.tool].reshape(3, 3),
            sim.site_xpos[arm.base],
            sim.site_xmat[arm.base].reshape(3, 3),
            work.goal_p,
            work.goal_r,
            work.turn,
        )
        return
    for i in range(len(arm.qpos)):
        delta = arm.scale[i] * min(1.0, max(-1.0, action[i]))
        work.goal_q[i] = sim.qpos[arm.qpos[i]] + delta


@jit
def _read_dynamics(sim: Sim, arm: Arm, work: Work) -> None:
    n = len(arm.dof)
    for i in range(n):
        work.bias[i] = sim.bias[arm.dof[i]]
        for j in range(n):
            work.mass[i, j] = sim.mass[arm.mass[i, j]]


@jit
def _jacobian(sim: Sim, arm: Arm, work: Work, site: int) -> None:
    nv = work.jac_full.shape[1]
    start = work.jac_full.ctypes.data
    mj_jac_site(sim.model, sim.data, start, start + 24 * nv, np.int32(site))
    for i in range(6):
        for k in range(len(arm.dof)):
            work.jac[i, k] = work.jac_full[i, arm.dof[k]]


@jit
def _tool_velocity(sim: Sim, arm: Arm, work: Work) -> None:
    """Tool velocity less that of the base site, into work.velocity."""
    _jacobian(sim, arm, work, arm.base)
    for i in range(6):
        work.velocity[i] = 0.0
        for k in range(len(arm.dof)):
            work.velocity[i] -= work.jac[i, k] * sim.qvel[arm.dof[k]]
    _jacobian(sim, arm, work, arm.tool)
    for i in range(6):
        for k in range(len(arm.dof)):
            work.velocity[i] += work.jac[i, k] * sim.qvel[arm.dof[k]]


@jit
def _arm_torque(sim: Sim, arm: Arm, work: Work, q0: Array) -> None:
    _read_dynamics(sim, arm, work)
    if arm.osc:
        _tool_velocity(sim, arm, work)
        pose_error(
            arm,
            sim.site_xpos[arm.tool],
            sim.site_xmat[arm.tool].reshape(3, 3),
            sim.site_xpos[arm.base],
            sim.site_xmat[arm.base].reshape(3, 3),
            work.goal_p,
            work.goal_r,
            work.velocity,
            work.wrench,
        )
        for i in range(len(arm.dof)):
            work.pull[i] = NULL_KP * (q0[i] - sim.qpos[arm.qpos[i]])
            work.pull[i] -= 2.0 * np.sqrt(NULL_KP) * sim.qvel[arm.dof[i]]
        osc_torque(
            work.mass, work.jac, work.wrench, work.pull, work.bias, work, work.torque
        )
        return
    for i in range(len(arm.dof)):
        work.pull[i] = arm.kp * (work.goal_q[i] - sim.qpos[arm.qpos[i]])
        work.pull[i] -= arm.kd * sim.qvel[arm.dof[i]]
    joint_torque(work.mass, work.pull, work.bias, work.torque)


@jit
def _drive_arm(sim: Sim, arm: Arm, work: Work) -> bool:
    """Clip the torque to the actuators' range and apply it; False if not finite."""
    finite = True
    for i in range(len(arm.actuator)):
        torque = work.torque[i]
        finite = finite and np.isfinite(torque)
        sim.ctrl[arm.actuator[i]] = min(arm.high[i], max(arm.low[i], torque))
    return finite


@jit
def _drive_gripper(sim: Sim, gripper: Gripper, action: float, command: Array) -> None:
    for i in range(len(gripper.actuator)):
        moved = command[i] + gripper.speed[i] * np.sign(action)
        command[i] = min(1.0, max(-1.0, moved))
        sim.ctrl[gripper.actuator[i]] = gripper.bias[i] + gripper.weight[i] * command[i]


@jit
def _advance(
    sim: Sim,
    plan: Plan,
    arm: Arm,
    gripper: Gripper,
    work: Work,
    action: Array,
    q0: Array,
    command: Array,
) -> bool:
    """One control period of the loaded world; False if it became non-finite."""
    for x in action:
        if np.isnan(x):  # the clips would make it -1: full speed
            return False
    for substep in range(plan.substeps):
        mj_step1(sim.model, sim.data)
        if substep == 0:
            _latch(sim, arm, work, action)
            _drive_gripper(sim, gripper, action[-1], command)
        _arm_torque(sim, arm, work, q0)
        if not _drive_arm(sim, arm, work):
            return False
        mj_step2(sim.model, sim.data)
        if _broken(sim):
            return False
    return True


@jit
def step_worlds(
    sim: Sim,
    plan: Plan,
    arm: Arm,
    gripper: Gripper,
    work: Work,
    actions: Array,
    states: Array,
    readings: Array,
    broken: Array,
    start: int,
    stop: int,
) -> None:
    """Step worlds [start, stop); a broken one keeps its state and its readings."""
    q0_at = plan.nq + 2 * plan.nv
    command_at = q0_at + len(arm.qpos)
    fields_at = command_at + len(gripper.actuator)
    command = np.empty(len(gripper.actuator))
    for w in range(start, stop):
        row = states[w]
        _load(sim, plan, fields_at, row)
        command[:] = row[command_at:fields_at]
        broken[w] = not _advance(
            sim, plan, arm, gripper, work, actions[w], row[q0_at:command_at], command
        )
        if not broken[w]:
            _store(sim, plan, row)
            row[command_at:fields_at] = command
            _gather(sim, plan, readings[w])


@jit
def refresh_worlds(
    sim: Sim, plan: Plan, fields_at: int, states: Array, readings: Array, worlds: Array
) -> None:
    """`mj_forward` on the given worlds, as robosuite does at the end of a reset."""
    sim.ctrl[:] = 0.0
    for w in worlds:
        _load(sim, plan, fields_at, states[w])
        mj_forward(sim.model, sim.data)
        _store(sim, plan, states[w])
        _gather(sim, plan, readings[w])
