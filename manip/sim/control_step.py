"""The controller of one substep, compiled: read the arm, compute and apply torques.

Symbols as in `manip.sim.control_laws`.
"""

from math import isfinite, sqrt

import numpy as np

from manip.compiled import kernel
from manip.sim.control_laws import (
    NULL_KP,
    Work,
    joint_torque,
    latch_pose_goal,
    osc_torque,
    pose_error,
)
from manip.sim.robot_model import Arm, Gripper
from manip.sim.sim_memory import Sim

Array = np.ndarray


@kernel
def control(
    sim: Sim, arm: Arm, gripper: Gripper, w: Work, action: Array, substep: int
) -> bool:
    """Set ctrl between `mj_step1` and `mj_step2`; False if it would not be finite.

    The goal is latched at the first substep of a control period, as in robosuite.
    """
    _read_arm(sim, arm, w)
    if substep == 0:
        _latch_goal(arm, w, action)
        _drive_gripper(sim, gripper, action[-1])
        for i in range(len(sim.peaks)):
            sim.peaks[i] = 0.0
    _arm_torque(arm, w)
    return _drive_arm(sim, arm, w)


@kernel
def _read_arm(sim: Sim, arm: Arm, w: Work) -> None:
    _read_joints(sim, arm, w)
    if arm.osc:
        _read_pose(sim, arm.tool, w.tool_p, w.tool_r)
        _read_pose(sim, arm.base, w.base_p, w.base_r)
        _read_jacobian(sim, arm, w)
        _read_velocity(arm, w)


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
    """J from MuJoCo's spatial axes `cdof` = (rotation, translation at `com`).

    Column k: Jr = axis[:3], Jp = axis[3:] + axis[:3] x (p - com)
    (mj_jac in MuJoCo's engine_core_util.c).
    """
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
    """Velocity of the tool, less that of the base site.

    J qd, but a joint below both sites contributes only Jr qd x (p - b): it turns the
    tool about the base site.
    """
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
def _latch_goal(arm: Arm, w: Work, action: Array) -> None:
    if arm.osc:
        latch_pose_goal(action, arm.scale, w)
        return
    for i in range(len(w.q)):  # goal_q = q + scale * clip(a, -1, 1)
        w.goal_q[i] = w.q[i] + arm.scale[i] * min(1.0, max(-1.0, action[i]))


@kernel
def _arm_torque(arm: Arm, w: Work) -> None:
    if arm.osc:
        # null space, critically damped: u = kp (q0 - q) - 2 sqrt(kp) qd
        for i in range(len(w.q)):
            w.joint_acc[i] = NULL_KP * (w.q0[i] - w.q[i])
            w.joint_acc[i] -= 2.0 * sqrt(NULL_KP) * w.qd[i]
        pose_error(w.gains[0], w.gains[1], w)
        osc_torque(w)
        return
    for i in range(len(w.q)):  # u = kp (goal_q - q) - kd qd
        w.joint_acc[i] = w.gains[0] * (w.goal_q[i] - w.q[i]) - w.gains[1] * w.qd[i]
    joint_torque(w)


@kernel
def _drive_arm(sim: Sim, arm: Arm, w: Work) -> bool:
    """Clip the torque to the actuators' range and apply it; False if not finite."""
    finite, n = True, len(w.torque)
    for i in range(n):
        finite = finite and isfinite(w.torque[i])
        torque = min(arm.high[i], max(arm.low[i], w.torque[i]))
        sim.ctrl[arm.actuator[i]] = torque
        sim.peaks[i] = max(sim.peaks[i], abs(w.qd[i]))
        sim.peaks[n + i] = max(sim.peaks[n + i], abs(torque))
    return finite


@kernel
def _drive_gripper(sim: Sim, gripper: Gripper, action: float) -> None:
    """Apply command = clip(command + speed * sign(action), -1, 1), then affine."""
    sign = np.sign(action)
    for i in range(len(gripper.actuator)):
        moved = sim.command[i] + gripper.speed[i] * sign
        sim.command[i] = min(1.0, max(-1.0, moved))
        sim.ctrl[gripper.actuator[i]] = (
            gripper.bias[i] + gripper.weight[i] * sim.command[i]
        )
