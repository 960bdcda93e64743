"""What the control laws' kernels share: read the arm, apply a torque.

Functions that fill a vector or a matrix take one of zeros of the right size, because a
kernel is compiled for each number of joints. Arithmetic is in float64: in float32, the
torques of a nearly singular arm are off by up to 2.7 N m.
"""

from typing import Any

import warp as wp

from manip.sim.warp.arm_memory import ArmData, ArmModel, LawState


@wp.func
def arm_mass(arm: ArmModel, sim: ArmData, env: int, mass: Any):
    """M [n, n]: the arm's block of the mass matrix."""
    for i in range(len(mass)):
        for k in range(len(mass)):
            mass[i, k] = wp.float64(sim.mass[env, arm.mass[i, k]])
    return mass


@wp.func
def joint_torque(arm: ArmModel, sim: ArmData, env: int, mass: Any, acc: Any):
    """tau = M u + h, where u = acc [n] is the desired acceleration."""
    torque = mass * acc
    for i in range(len(acc)):
        torque[i] = torque[i] + wp.float64(sim.bias[env, arm.dof[i]])
    return torque


@wp.func
def clipped(action: wp.array2d[float], env: int, k: int) -> wp.float64:
    """A number of an action, clipped to [-1, 1]."""
    return wp.float64(wp.clamp(action[env, k], -1.0, 1.0))


@wp.func
def begin_period(law: LawState, action: wp.array2d[float], env: int):
    """Set peaks to 0, and `broken` where the action holds NaN."""
    law.broken[env] = 0
    for k in range(action.shape[1]):
        if wp.isnan(action[env, k]):
            law.broken[env] = 1
    for k in range(law.peaks.shape[1]):
        law.peaks[env, k] = 0.0


@wp.func
def hold_still(arm: ArmModel, sim: ArmData, env: int):
    """Set the arm's controls to 0."""
    for i in range(arm.actuator.shape[0]):
        sim.ctrl[env, arm.actuator[i]] = 0.0


@wp.func
def all_finite(values: Any) -> bool:
    """Whether all numbers of a vector are finite."""
    for i in range(len(values)):
        if not wp.isfinite(values[i]):
            return False
    return True


@wp.func
def apply_torque(arm: ArmModel, sim: ArmData, law: LawState, env: int, torque: Any):
    """Clip the torque to the actuators' range and apply it; 0 if it is not finite."""
    if not all_finite(torque):
        law.broken[env] = 1
        hold_still(arm, sim, env)
        return
    for i in range(len(torque)):
        tau = wp.clamp(wp.float32(torque[i]), arm.low[i], arm.high[i])
        speed = wp.abs(sim.qvel[env, arm.dof[i]])
        at = len(torque) + i
        sim.ctrl[env, arm.actuator[i]] = tau
        law.peaks[env, i] = wp.max(law.peaks[env, i], speed)
        law.peaks[env, at] = wp.max(law.peaks[env, at], wp.abs(tau))
