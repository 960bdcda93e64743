"""robosuite's OSC_POSE and OSC_POSITION laws as kernels, one thread per environment.

Symbols and sources as in `manip.sim.control_laws`.
"""

from functools import cache
from math import sqrt
from typing import Any

import warp as wp

from manip.sim.control_laws import NULL_KP
from manip.sim.warp.arm_memory import ArmData, ArmModel, LawState
from manip.sim.warp.law_parts import (
    apply_torque,
    arm_mass,
    begin_period,
    clipped,
    hold_still,
    joint_torque,
)
from manip.sim.warp.linear_algebra import factor, solve, solve_rows
from manip.sim.warp.rotations import rotation_from_vector, wide, wide_matrix

Vector6 = wp.types.vector(6, wp.float64)

_KP = wp.constant(wp.float64(NULL_KP))
_KD = wp.constant(wp.float64(2.0 * sqrt(NULL_KP)))


@wp.kernel(enable_backward=False)
def latch_pose(
    arm: ArmModel, sim: ArmData, law: LawState, action: wp.array2d[float]
) -> None:
    """Set the pose goal in the base frame: B^T (p - b) + dx and Rot(turn) B^T R."""
    env = wp.tid()
    begin_period(law, action, env)
    p, r = tool_pose(arm, sim, env)
    b, base_r = base_pose(arm, sim, env)
    step = wp.vec3d()
    turn = wp.vec3d()
    for i in range(3):
        step[i] = wp.float64(arm.scale[i]) * clipped(action, env, i)
        if arm.scale.shape[0] == 6:
            turn[i] = wp.float64(arm.scale[3 + i]) * clipped(action, env, 3 + i)
    to_base = wp.transpose(base_r)
    law.goal_p[env] = to_base * (p - b) + step
    law.goal_r[env] = rotation_from_vector(turn) * (to_base * r)


@cache
def drive_pose(joints: int) -> Any:
    """The kernel that sets ctrl of an arm, between step1 and step2.

    tau = Jp^T Lp f + Jr^T Lr t + h + M u - J^T L J u
    """
    vector = wp.types.vector(joints, wp.float64)
    matrix = wp.types.matrix((joints, joints), wp.float64)
    jacobian = wp.types.matrix((6, joints), wp.float64)

    @wp.kernel(module="unique", enable_backward=False)
    def drive(arm: ArmModel, sim: ArmData, law: LawState) -> None:
        env = wp.tid()
        if law.broken[env] != 0:
            hold_still(arm, sim, env)
            return
        jac = tool_jacobian(arm, sim, env, jacobian())
        mass = arm_mass(arm, sim, env, matrix())
        acc = null_space_acceleration(arm, sim, law, env, vector())
        torque = joint_torque(arm, sim, env, mass, acc)
        x = solve_rows(factor(mass), jac, 6, joints)
        inertia = x * wp.transpose(x)  # J M^-1 J^T
        wrench = pose_wrench(arm, sim, law, env, tool_velocity(arm, sim, env, jac))
        torque = torque + wp.transpose(jac) * task_force(inertia, wrench, jac * acc)
        apply_torque(arm, sim, law, env, torque)

    return drive


@wp.func
def tool_pose(arm: ArmModel, sim: ArmData, env: int):
    """p [3] and R [3, 3] of the grip site."""
    r = wide_matrix(sim.site_xmat[env, arm.tool])
    return wide(sim.site_xpos[env, arm.tool]), r


@wp.func
def base_pose(arm: ArmModel, sim: ArmData, env: int):
    """b [3] and B [3, 3] of the base site."""
    r = wide_matrix(sim.site_xmat[env, arm.base])
    return wide(sim.site_xpos[env, arm.base]), r


@wp.func
def tool_jacobian(arm: ArmModel, sim: ArmData, env: int, jac: Any):
    """J [6, n] from MuJoCo's spatial axes, as `_read_jacobian` in control_step."""
    p = wide(sim.site_xpos[env, arm.tool])
    to_tool = p - wide(sim.com[env, arm.root])
    for k in range(arm.dof.shape[0]):
        axis = sim.cdof[env, arm.dof[k]]
        turn = wide(wp.spatial_top(axis))
        move = wide(wp.spatial_bottom(axis)) + wp.cross(turn, to_tool)
        for i in range(3):
            jac[i, k] = move[i]
            jac[3 + i, k] = turn[i]
    return jac


@wp.func
def tool_velocity(arm: ArmModel, sim: ArmData, env: int, jac: Any):
    """Velocity [6] of the tool, less that of the base site.

    A joint below both sites contributes only Jr qd x (p - b).
    """
    p = wide(sim.site_xpos[env, arm.tool])
    lever = p - wide(sim.site_xpos[env, arm.base])
    velocity = Vector6()
    for k in range(arm.dof.shape[0]):
        speed = wp.float64(sim.qvel[env, arm.dof[k]])
        move = wp.vec3d(jac[0, k], jac[1, k], jac[2, k])
        turn = wp.vec3d(jac[3, k], jac[4, k], jac[5, k])
        if arm.moves_base[k] != 0:
            move = wp.cross(turn, lever)
            turn = wp.vec3d()
        for i in range(3):
            velocity[i] = velocity[i] + move[i] * speed
            velocity[3 + i] = velocity[3 + i] + turn[i] * speed
    return velocity


@wp.func
def null_space_acceleration(
    arm: ArmModel, sim: ArmData, law: LawState, env: int, acc: Any
):
    """u = kp (q0 - q) - 2 sqrt(kp) qd, critically damped."""
    for i in range(len(acc)):
        q = wp.float64(sim.qpos[env, arm.qpos[i]])
        qd = wp.float64(sim.qvel[env, arm.dof[i]])
        acc[i] = _KP * (wp.float64(law.q0[env, i]) - q) - _KD * qd
    return acc


@wp.func
def pose_wrench(arm: ArmModel, sim: ArmData, law: LawState, env: int, velocity: Any):
    """[6]: desired force and moment, kp * error - kd * velocity.

    The rotation's error is half the sum of the axes' cross products.
    """
    p, r = tool_pose(arm, sim, env)
    b, base_r = base_pose(arm, sim, env)
    kp, kd = wp.float64(law.gains[env, 0]), wp.float64(law.gains[env, 1])
    reach = b + base_r * law.goal_p[env] - p
    target = base_r * law.goal_r[env]
    turn = wp.vec3d()
    for c in range(3):
        turn = turn + wp.cross(column(r, c), column(target, c))
    wrench = Vector6()
    for i in range(3):
        wrench[i] = kp * reach[i] - kd * velocity[i]
        wrench[3 + i] = kp * wp.float64(0.5) * turn[i] - kd * velocity[3 + i]
    return wrench


@wp.func
def column(m: wp.mat33d, c: int) -> wp.vec3d:
    """A column of a matrix."""
    return wp.vec3d(m[0, c], m[1, c], m[2, c])


@wp.func
def task_force(inertia: Any, wrench: Any, task: Any):
    """[6]: Lp f and Lr t, less L J u.

    L = inertia^-1; Lp and Lr belong to its linear and its angular block alone
    (robosuite's "uncoupling"). task = J u.
    """
    angular = wp.mat33d()
    force = wp.vec3d()
    moment = wp.vec3d()
    for i in range(3):
        force[i] = wrench[i]
        moment[i] = wrench[3 + i]
        for k in range(3):
            angular[i, k] = inertia[3 + i, 3 + k]
    lower = factor(inertia)
    result = -solve(lower, task)
    force = solve(lower, force)
    moment = solve(factor(angular), moment)
    for i in range(3):
        result[i] = result[i] + force[i]
        result[3 + i] = result[3 + i] + moment[i]
    return result
