"""The arrays that the control laws' kernels read and write, as structs of Warp."""

from typing import Any

import mujoco
import numpy as np
import warp as wp

from manip.sim.robot_model import Arm

Array = np.ndarray


@wp.struct
class ArmModel:
    """An arm's constants; members as in `manip.sim.robot_model.Arm`."""

    qpos: wp.array[int]
    dof: wp.array[int]
    actuator: wp.array[int]
    mass: wp.array2d[int]
    low: wp.array[float]
    high: wp.array[float]
    scale: wp.array[float]
    moves_base: wp.array[int]
    tool: int
    base: int
    root: int


@wp.struct
class ArmData:
    """The arrays of mujoco_warp's Data that a law reads, and `ctrl`, which it sets.

    mass [N, k]: the entries of the mass matrix, as `ArmModel.mass` numbers them.
    """

    qpos: wp.array2d[float]
    qvel: wp.array2d[float]
    mass: wp.array2d[float]
    bias: wp.array2d[float]
    cdof: wp.array2d[wp.spatial_vector]
    com: wp.array2d[wp.vec3]
    site_xpos: wp.array2d[wp.vec3]
    site_xmat: wp.array2d[wp.mat33]
    ctrl: wp.array2d[float]


@wp.struct
class LawState:
    """What a law keeps for each of N environments.

    gains [N, 2]: kp, kd. q0 [N, n]: the arm at the episode's start. goal_p, goal_r,
    goal_q: as in `manip.sim.control_laws`. peaks [N, 2 n]: the largest |speed| and
    |torque| of each joint in the control period. broken [N]: 1 once a number was not
    finite; the arm's controls are 0 then.
    """

    gains: wp.array2d[float]
    q0: wp.array2d[float]
    goal_p: wp.array[wp.vec3d]
    goal_r: wp.array[wp.mat33d]
    goal_q: wp.array2d[wp.float64]
    peaks: wp.array2d[float]
    broken: wp.array[int]


def arm_model(arm: Arm, mass: Array) -> ArmModel:
    """Copy an arm's constants to the device; mass [n, n] as `mass_addresses` gives."""
    model = ArmModel()
    model.qpos, model.dof = _ints(arm.qpos), _ints(arm.dof)
    model.actuator, model.mass = _ints(arm.actuator), _ints(mass)
    model.low, model.high = _floats(arm.low), _floats(arm.high)
    model.scale, model.moves_base = _floats(arm.scale), _ints(arm.moves_base)
    model.tool, model.base, model.root = arm.tool, arm.base, arm.root
    return model


def arm_data(data: Any) -> ArmData:
    """Refer to the arrays of a mujoco_warp.Data."""
    arm = ArmData()
    arm.qpos, arm.qvel, arm.ctrl = data.qpos, data.qvel, data.ctrl
    arm.mass = data.qM.reshape((data.nworld, -1))
    arm.bias, arm.cdof, arm.com = data.qfrc_bias, data.cdof, data.subtree_com
    arm.site_xpos, arm.site_xmat = data.site_xpos, data.site_xmat
    return arm


def law_state(arm: Arm, num_envs: int) -> LawState:
    """Allocate a law's state; the gains are the arm's."""
    n, state = len(arm.dof), LawState()
    state.gains = _floats(np.tile([arm.kp, arm.kd], (num_envs, 1)))
    state.q0 = wp.zeros((num_envs, n), dtype=float)
    state.goal_p = wp.zeros(num_envs, dtype=wp.vec3d)
    state.goal_r = wp.zeros(num_envs, dtype=wp.mat33d)
    state.goal_q = wp.zeros((num_envs, n), dtype=wp.float64)
    state.peaks = wp.zeros((num_envs, 2 * n), dtype=float)
    state.broken = wp.zeros(num_envs, dtype=int)
    return state


def mass_addresses(physics: mujoco.MjModel, data: Any, dof: Array) -> Array:
    """[n, n]: where an environment's qM, flattened, holds M[dof[i], dof[j]].

    mujoco_warp stores a dense M as padded rows, a sparse one in MuJoCo's older layout:
    from each diagonal entry (dof_Madr) up the tree (dof_parentid).
    """
    if data.qM.shape[1] > 1:
        return dof[:, None] * data.qM.shape[2] + dof[None, :]
    table = np.full((physics.nv, physics.nv), -1)
    for row in range(physics.nv):
        at, column = int(physics.dof_Madr[row]), row
        while column >= 0:
            table[row, column] = at
            at, column = at + 1, int(physics.dof_parentid[column])
    return np.maximum(table, table.T)[np.ix_(dof, dof)]


def _ints(values: Any) -> Any:
    return wp.array(np.asarray(values, np.int32), dtype=int)


def _floats(values: Any) -> Any:
    return wp.array(np.asarray(values, np.float32), dtype=float)
