"""robosuite's control laws, one function each, compiled.

Symbols, in the frame of the world unless said: p [3], R [3, 3] position and rotation
of the grip site; b, B those of the arm's base site; q, qd [n] arm joints; q0 [n] arm
joints at the episode's start; M [n, n] arm block of the joint-space mass matrix;
h [n] Coriolis and gravity torques; J = [Jp; Jr] [6, n] Jacobian of the grip site.
Sources: robosuite 1.5.2, controllers/parts/arm/osc.py, parts/generic/joint_pos.py,
utils/control_utils.py; Khatib, "A unified approach for motion and force control of
robot manipulators", 1987.
"""

from math import cos, sin, sqrt
from typing import Any

import numpy as np

from manip.compiled import jit

Array = np.ndarray

NULL_KP = 10.0
"""Null-space stiffness towards q0 [1/s^2] (control_utils.nullspace_torques)."""


@jit
def factor(a: Array, n: int) -> None:
    """Overwrite the lower triangle of a[:n, :n] by its Cholesky factor."""
    for j in range(n):
        for k in range(j):
            for i in range(j, n):
                a[i, j] -= a[i, k] * a[j, k]
        pivot = sqrt(a[j, j])
        for i in range(j, n):
            a[i, j] /= pivot


@jit
def forward_solve(factor_: Array, x: Array, n: int) -> None:
    """Overwrite x [n] by L^-1 x, L the lower triangle of `factor_`."""
    for i in range(n):
        for k in range(i):
            x[i] -= factor_[i, k] * x[k]
        x[i] /= factor_[i, i]


@jit
def solve(factor_: Array, x: Array, n: int) -> None:
    """Overwrite x [n] by (L L^T)^-1 x."""
    forward_solve(factor_, x, n)
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= factor_[k, i] * x[k]
        x[i] /= factor_[i, i]


@jit
def rotation_from_vector(vector: Array, out: Array) -> None:
    """Rotation matrix of a rotation vector [rad], rounded as robosuite rounds it.

    robosuite goes through a quaternion in float32 (transform_utils.quat2mat); the
    rounding is repeated here so that goals agree to the last bit it leaves.
    """
    angle = sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    q = np.zeros(4, np.float32)
    q[0] = 1.0
    if angle > 0.0:
        q[0] = cos(angle / 2.0)
        for k in range(3):
            q[k + 1] = vector[k] / angle * sin(angle / 2.0)
    norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    for k in range(4):
        q[k] = q[k] * sqrt(2.0 / norm)
    w, x, y, z = q[0], q[1], q[2], q[3]
    one = 1.0
    out[0, 0], out[0, 1], out[0, 2] = one - y * y - z * z, x * y - z * w, x * z + y * w
    out[1, 0], out[1, 1], out[1, 2] = x * y + z * w, one - x * x - z * z, y * z - x * w
    out[2, 0], out[2, 1], out[2, 2] = x * z - y * w, y * z + x * w, one - x * x - y * y


@jit
def latch_pose_goal(
    action: Array,
    scale: Array,
    p: Array,
    rot: Array,
    b: Array,
    base: Array,
    goal_p: Array,
    goal_r: Array,
    turn: Array,
) -> None:
    """Pose goal in the base frame: B^T (p - b) + dx and Rot(w) B^T R.

    dx [m] and w [rad] are the first and last three of `action` [6] (clipped to
    [-1, 1]) times `scale`; "achieved" goals start from where the tool is.
    """
    vector = np.empty(3)
    for k in range(3):
        vector[k] = scale[3 + k] * min(1.0, max(-1.0, action[3 + k]))
    rotation_from_vector(vector, turn)
    for i in range(3):
        goal_p[i] = scale[i] * min(1.0, max(-1.0, action[i]))
        for k in range(3):
            goal_p[i] += base[k, i] * (p[k] - b[k])
    local = base.T @ rot
    goal_r[:] = turn @ local


@jit
def pose_error(
    arm: Any,
    p: Array,
    rot: Array,
    b: Array,
    base: Array,
    goal_p: Array,
    goal_r: Array,
    velocity: Array,
    out: Array,
) -> None:
    """Desired force [3] and torque [3]: kp * error - kd * velocity, into out [6].

    The rotation error is 0.5 * sum_k R[:, k] x R*[:, k] = sin(angle) * axis;
    `velocity` [6] is the tool's, less the base site's.
    """
    target = base @ goal_r
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        reach = b[i] - p[i]
        turn = 0.0
        for c in range(3):
            reach += base[i, c] * goal_p[c]
            turn += 0.5 * (rot[j, c] * target[k, c] - rot[k, c] * target[j, c])
        out[i] = arm.kp * reach - arm.kd * velocity[i]
        out[3 + i] = arm.kp * turn - arm.kd * velocity[3 + i]


@jit
def osc_torque(
    mass: Array, jac: Array, wrench: Array, pull: Array, h: Array, work: Any, out: Array
) -> None:
    """tau = Jp^T Lp f + Jr^T Lr t + h + M u - J^T L J u, into out [n].

    L = (J M^-1 J^T)^-1, Lp and Lr the same of the linear and angular blocks alone
    (uncoupled), [f; t] = `wrench` [6], u = `pull` [n] the null-space acceleration.
    """
    n = mass.shape[0]
    for i in range(n):
        out[i] = h[i]
        for k in range(n):
            out[i] += mass[i, k] * pull[k]
    work.mass_factor[:] = mass
    factor(work.mass_factor, n)
    for i in range(6):
        work.x[i, :] = jac[i, :]
        forward_solve(work.mass_factor, work.x[i], n)
    for i in range(6):
        for j in range(i + 1):
            work.inertia[i, j] = 0.0
            for k in range(n):
                work.inertia[i, j] += work.x[i, k] * work.x[j, k]
    work.linear[:] = work.inertia[:3, :3]
    work.angular[:] = work.inertia[3:, 3:]
    factor(work.inertia, 6)
    factor(work.linear, 3)
    factor(work.angular, 3)
    for i in range(6):
        work.task[i] = 0.0
        for k in range(n):
            work.task[i] += jac[i, k] * pull[k]
    solve(work.inertia, work.task, 6)
    solve(work.linear, wrench[:3], 3)
    solve(work.angular, wrench[3:], 3)
    for k in range(n):
        for i in range(6):
            out[k] += jac[i, k] * (wrench[i] - work.task[i])


@jit
def joint_torque(mass: Array, acceleration: Array, h: Array, out: Array) -> None:
    """tau = M (kp (q* - q) - kd qd) + h, into out [n]."""
    n = mass.shape[0]
    for i in range(n):
        out[i] = h[i]
        for k in range(n):
            out[i] += mass[i, k] * acceleration[k]
