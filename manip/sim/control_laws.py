"""robosuite's control laws, one compiled function each.

Symbols (SI units, world frame unless stated):
    p [3], R [3, 3]: position and rotation of the grip site
    b [3], B [3, 3]: position and rotation of the arm's base site
    q, qd [n]: positions and velocities of the arm's joints
    q0 [n]: q at the start of the episode
    M [n, n]: the arm's block of the joint-space mass matrix
    h [n]: Coriolis and gravity torques
    J = [Jp; Jr] [6, n]: Jacobian of the grip site

Sources: robosuite 1.5.2, controllers/parts/arm/osc.py, parts/generic/joint_pos.py,
utils/control_utils.py; Khatib, "A unified approach for motion and force control of
robot manipulators", IEEE J. Robotics and Automation, 1987.

numba compiles a function for each size of a record's array. A slice `[:]` of it has no
fixed size, so that one compiled version of `factor` and `solve` serves all arrays.
"""

from math import cos, sin, sqrt
from typing import Any

import numpy as np

from manip.compiled import kernel

Array = np.ndarray

Work = Any
"""A record of `new_works`; numba passes it as one pointer."""

Works = Any
"""The records of all arms."""

NULL_KP = 10.0
"""Null-space stiffness towards q0 [1/s^2] (control_utils.nullspace_torques)."""


def new_works(robots: int, n: int) -> Works:
    """Build the records that the control laws of arms with n joints read and write.

    Input: q, qd, q0, mass (M), bias (h), jac (J), tool_p (p), tool_r (R), base_p (b),
    base_r (B); velocity [6], the tool's less the base site's.
    Goals: goal_p [3], goal_r [3, 3] of the tool in the base frame; goal_q [n].
    Desired: force [3], moment [3] of the tool; joint_acc [n] of the joints.
    Result: torque [n]. The other members hold intermediate results.
    """
    fields = [
        ("q", float, n), ("qd", float, n), ("q0", float, n),
        ("mass", float, (n, n)), ("bias", float, n), ("jac", float, (6, n)),
        ("tool_p", float, 3), ("tool_r", float, (3, 3)),
        ("base_p", float, 3), ("base_r", float, (3, 3)), ("velocity", float, 6),
        ("goal_p", float, 3), ("goal_r", float, (3, 3)), ("goal_q", float, n),
        ("force", float, 3), ("moment", float, 3), ("joint_acc", float, n),
        ("torque", float, n),
        ("turn", float, (3, 3)), ("target", float, (3, 3)),
        ("factor", float, (n, n)), ("x", float, (6, n)),
        ("inertia", float, (6, 6)), ("angular", float, (3, 3)), ("task", float, 6),
    ]  # fmt: skip
    return np.zeros(robots, fields).view(np.recarray)


@kernel
def factor(a: Array) -> None:
    """Overwrite the lower triangle of a [n, n] with L of its Cholesky factors L L^T."""
    n = len(a)
    for j in range(n):
        for k in range(j):
            for i in range(j, n):
                a[i, j] -= a[i, k] * a[j, k]
        pivot = sqrt(a[j, j])
        for i in range(j, n):
            a[i, j] /= pivot


@kernel
def forward_solve(lower: Array, x: Array) -> None:
    """Overwrite x [n] with L^-1 x; L is the lower triangle of `lower[:n, :n]`."""
    for i in range(len(x)):
        for k in range(i):
            x[i] -= lower[i, k] * x[k]
        x[i] /= lower[i, i]


@kernel
def solve(lower: Array, x: Array) -> None:
    """Overwrite x [n] with (L L^T)^-1 x."""
    n = len(x)
    forward_solve(lower, x)
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= lower[k, i] * x[k]
        x[i] /= lower[i, i]


@kernel
def multiply(a: Array, b: Array, out: Array) -> None:
    """Matrix product: out = a b, all [3, 3]."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@kernel
def rotation_from_vector(vector: Array, out: Array) -> None:
    """Rotation matrix of a rotation vector [rad], rounded as in robosuite.

    robosuite computes it from a float32 quaternion (transform_utils.quat2mat). The same
    rounding here makes goals equal to robosuite's in every bit.
    """
    x, y, z = vector[0], vector[1], vector[2]
    angle = sqrt(x**2 + y**2 + z**2)
    length = angle if angle > 0.0 else 1.0
    # quaternion (a, b, c, d) = (cos(angle / 2), axis * sin(angle / 2))
    a, half = np.float32(cos(angle / 2.0)), sin(angle / 2.0)
    b, c = np.float32(x / length * half), np.float32(y / length * half)
    d = np.float32(z / length * half)
    # scaled by sqrt(2) / norm, products of two entries need no factor 2
    root = sqrt(2.0 / (a * a + b * b + c * c + d * d))
    a, b = np.float32(a * root), np.float32(b * root)
    c, d = np.float32(c * root), np.float32(d * root)
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - c * c - d * d, b * c - d * a, b * d + c * a
    out[1, 0], out[1, 1], out[1, 2] = b * c + d * a, 1.0 - b * b - d * d, c * d - b * a
    out[2, 0], out[2, 1], out[2, 2] = b * d - c * a, c * d + b * a, 1.0 - b * b - c * c


@kernel
def latch_pose_goal(action: Array, scale: Array, w: Work) -> None:
    """Set the pose goal in the base frame: B^T (p - b) + dx and Rot(turn) B^T R.

    dx [m] and turn [rad] are the first and the next three numbers of `action`, clipped
    to [-1, 1], times `scale`. They are relative to the present pose (robosuite's goal
    update mode "achieved"). A scale [3] has no turn (OSC_POSITION): the goal's rotation
    is the present one.
    """
    turns = len(scale) == 6
    for i in range(3):
        w.goal_p[i] = scale[i] * min(1.0, max(-1.0, action[i]))
        w.moment[i] = 0.0
        if turns:
            w.moment[i] = scale[3 + i] * min(1.0, max(-1.0, action[3 + i]))
        for k in range(3):
            w.goal_p[i] += w.base_r[k, i] * (w.tool_p[k] - w.base_p[k])
    rotation_from_vector(w.moment, w.turn)
    multiply(w.base_r.T, w.tool_r, w.target)
    multiply(w.turn, w.target, w.goal_r)


@kernel
def pose_error(kp: float, kd: float, w: Work) -> None:
    """Set the tool's desired force and moment: kp * error - kd * velocity.

    The rotation error is 0.5 * sum_k R[:, k] x R*[:, k] = sin(angle) * axis.
    """
    multiply(w.base_r, w.goal_r, w.target)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        reach = w.base_p[i] - w.tool_p[i]
        turn = 0.0
        for c in range(3):
            reach += w.base_r[i, c] * w.goal_p[c]
            turn += 0.5 * w.tool_r[j, c] * w.target[k, c]
            turn -= 0.5 * w.tool_r[k, c] * w.target[j, c]
        w.force[i] = kp * reach - kd * w.velocity[i]
        w.moment[i] = kp * turn - kd * w.velocity[3 + i]


@kernel
def joint_torque(w: Work) -> None:
    """Set tau = M u + h, where u = `joint_acc` [n] is the desired acceleration."""
    n = len(w.q)
    for i in range(n):
        w.torque[i] = w.bias[i]
        for k in range(n):
            w.torque[i] += w.mass[i, k] * w.joint_acc[k]


@kernel
def osc_torque(w: Work) -> None:
    """Set tau = Jp^T Lp f + Jr^T Lr t + h + M u - J^T L J u.

    L = (J M^-1 J^T)^-1 [6, 6] is the tool's inertia; Lp and Lr are those of the linear
    and the angular block alone (robosuite's "uncoupling"). f = `force`, t = `moment`,
    u = `joint_acc`, the null-space acceleration.
    """
    n = len(w.q)
    joint_torque(w)
    factor_inertias(w)
    for i in range(6):  # task = J u
        w.task[i] = 0.0
        for k in range(n):
            w.task[i] += w.jac[i, k] * w.joint_acc[k]
    solve(w.inertia[:], w.task[:])  # L J u
    solve(w.inertia[:], w.force[:])  # Lp f, with the leading 3 rows of the factor
    solve(w.angular[:], w.moment[:])  # Lr t
    for k in range(n):
        for i in range(3):
            w.torque[k] += w.jac[i, k] * (w.force[i] - w.task[i])
            w.torque[k] += w.jac[3 + i, k] * (w.moment[i] - w.task[3 + i])


@kernel
def factor_inertias(w: Work) -> None:
    """Compute the Cholesky factors of J M^-1 J^T [6, 6] and of its angular block.

    The factor of the linear block is the leading corner of the whole factor. With
    M = C C^T and X = C^-1 J^T, J M^-1 J^T = X^T X.
    """
    n = len(w.q)
    for i in range(n):
        for k in range(i + 1):
            w.factor[i, k] = w.mass[i, k]
    factor(w.factor[:])
    for i in range(6):
        for k in range(n):
            w.x[i, k] = w.jac[i, k]
        forward_solve(w.factor[:], w.x[i])
        for j in range(i + 1):
            w.inertia[i, j] = 0.0
            for k in range(n):
                w.inertia[i, j] += w.x[i, k] * w.x[j, k]
    for i in range(3):
        for j in range(i + 1):
            w.angular[i, j] = w.inertia[3 + i, 3 + j]
    factor(w.inertia[:])
    factor(w.angular[:])
