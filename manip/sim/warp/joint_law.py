"""robosuite's JOINT_POSITION law as kernels, one thread per environment.

Symbols and sources as in `manip.sim.control_laws`.
"""

from functools import cache
from typing import Any

import warp as wp

from manip.sim.warp.arm_memory import ArmData, ArmModel, LawState
from manip.sim.warp.law_parts import (
    apply_torque,
    arm_mass,
    begin_period,
    clipped,
    hold_still,
    joint_torque,
)


@wp.kernel(enable_backward=False)
def latch_joints(
    arm: ArmModel, sim: ArmData, law: LawState, action: wp.array2d[float]
) -> None:
    """goal_q = q + scale * clip(a, -1, 1)."""
    env = wp.tid()
    begin_period(law, action, env)
    for i in range(arm.dof.shape[0]):
        q = wp.float64(sim.qpos[env, arm.qpos[i]])
        step = wp.float64(arm.scale[i]) * clipped(action, env, i)
        law.goal_q[env, i] = q + step


@cache
def drive_joints(joints: int) -> Any:
    """The kernel that sets ctrl of an arm: tau = M u + h, between step1 and step2."""
    vector = wp.types.vector(joints, wp.float64)
    matrix = wp.types.matrix((joints, joints), wp.float64)

    @wp.kernel(module="unique", enable_backward=False)
    def drive(arm: ArmModel, sim: ArmData, law: LawState) -> None:
        env = wp.tid()
        if law.broken[env] != 0:
            hold_still(arm, sim, env)
            return
        acc = joint_acceleration(arm, sim, law, env, vector())
        mass = arm_mass(arm, sim, env, matrix())
        torque = joint_torque(arm, sim, env, mass, acc)
        apply_torque(arm, sim, law, env, torque)

    return drive


@wp.func
def joint_acceleration(arm: ArmModel, sim: ArmData, law: LawState, env: int, acc: Any):
    """u = kp (goal_q - q) - kd qd."""
    kp, kd = wp.float64(law.gains[env, 0]), wp.float64(law.gains[env, 1])
    for i in range(len(acc)):
        q = wp.float64(sim.qpos[env, arm.qpos[i]])
        qd = wp.float64(sim.qvel[env, arm.dof[i]])
        acc[i] = kp * (law.goal_q[env, i] - q) - kd * qd
    return acc
