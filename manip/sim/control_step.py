"""The controllers of one substep, compiled: read arms, compute and apply torques.

Symbols as in `manip.sim.control_laws`.
"""

from math import isfinite, sqrt

import numpy as np

from manip.compiled import kernel
from manip.sim.control_laws import (
    NULL_KP,
    Work,
    Works,
    joint_torque,
    latch_pose_goal,
    osc_torque,
    pose_error,
)
from manip.sim.robot_model import Arm, Gripper, Robot
from manip.sim.sim_memory import Sim

Array = np.ndarray


@kernel
def control(
    sim: Sim, robots: tuple[Robot, ...], works: Works, action: Array, substep: int
) -> bool:
    """Set ctrl between `mj_step1` and `mj_step2`; False if it would not be finite.

    The action holds each robot's numbers in turn, as in robosuite.
    """
    finite, size = True, len(action) // len(robots)
    for k in range(len(robots)):
        own = action[k * size : (k + 1) * size]
        arm, gripper = robots[k]
        finite = _control(sim, k, arm, gripper, works[k], own, substep) and finite
    return finite


@kernel
def _control(
    sim: Sim,
    k: int,
    arm: Arm,
    gripper: Gripper,
    w: Work,
    action: Array,
    substep: int,
) -> bool:
    """Control robot k. Its goal is latched at the first substep of a control period."""
    _read_arm(sim, arm, w)
    if substep == 0:
        _latch_goal(arm, w, action)
        _drive_gripper(sim, sim.command[k], gripper, action[-1])
        sim.peaks[:, k] = 0.0
    _arm_torque(sim.gains, arm, w)
    return _drive_arm(sim, sim.peaks[0, k], sim.peaks[1, k], arm, w)


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
def _arm_torque(gains: Array, arm: Arm, w: Work) -> None:
    if arm.osc:
        # null space, critically damped: u = kp (q0 - q) - 2 sqrt(kp) qd
        for i in range(len(w.q)):
            w.joint_acc[i] = NULL_KP * (w.q0[i] - w.q[i])
            w.joint_acc[i] -= 2.0 * sqrt(NULL_KP) * w.qd[i]
        pose_error(gains[0], gains[1], w)
        osc_torque(w)
        return
    for i in range(len(w.q)):  # u = kp (goal_q - q) - kd qd
        w.joint_acc[i] = gains[0] * (w.goal_q[i] - w.q[i]) - gains[1] * w.qd[i]
    joint_torque(w)


@kernel
def _drive_arm(sim: Sim, speeds: Array, torques: Array, arm: Arm, w: Work) -> bool:
    """Clip the torque to the actuators' range and apply it; False if not finite.

    speeds, torques [n]: the peaks of the arm's joints.
    """
    finite = True
    for i in range(len(w.torque)):
        finite = finite and isfinite(w.torque[i])
        torque = min(arm.high[i], max(arm.low[i], w.torque[i]))
        sim.ctrl[arm.actuator[i]] = torque
        speeds[i] = max(speeds[i], abs(w.qd[i]))
        torques[i] = max(torques[i], abs(torque))
    return finite


@kernel
def _drive_gripper(sim: Sim, command: Array, gripper: Gripper, action: float) -> None:
    """Apply command = clip(command + speed * sign(action), -1, 1), then affine."""
    sign = np.sign(action)
    for i in range(len(gripper.actuator)):
        moved = command[i] + gripper.speed[i] * sign
        command[i] = min(1.0, max(-1.0, moved))
        sim.ctrl[gripper.actuator[i]] = gripper.bias[i] + gripper.weight[i] * command[i]
