"""The control laws against numpy, scipy and robosuite's own functions."""

import numpy as np
import pytest
from robosuite.utils import transform_utils
from robosuite.utils.control_utils import nullspace_torques, opspace_matrices
from scipy.spatial.transform import Rotation

from manip.compiled import jit
from manip.sim import control_laws as control
from manip.sim.control_laws import NULL_KP, Work, new_works
from manip.sim.scene import Scene

Array = np.ndarray

factor, forward_solve, solve, multiply = (
    jit(law.py_func)
    for law in (control.factor, control.forward_solve, control.solve, control.multiply)
)
rotation_from_vector, latch_pose_goal, pose_error, osc_torque, joint_torque = (
    jit(law.py_func)
    for law in (
        control.rotation_from_vector,
        control.latch_pose_goal,
        control.pose_error,
        control.osc_torque,
        control.joint_torque,
    )
)
SCALE = np.array([0.05, 0.05, 0.05, 0.5, 0.5, 0.5])
SEEDS = range(4)


def positive_definite(rng: np.random.Generator, n: int) -> Array:
    root = rng.normal(size=(n, n))
    return root @ root.T + np.eye(n)


def rotation(rng: np.random.Generator) -> Array:
    return Rotation.random(rng=rng).as_matrix()


# Linear algebra


@pytest.mark.parametrize("n", [1, 3, 6, 7])
def test_factor_is_cholesky(n: int) -> None:
    a = positive_definite(np.random.default_rng(n), n)
    ours = a.copy()
    factor(ours)
    np.testing.assert_allclose(np.tril(ours), np.linalg.cholesky(a), rtol=1e-12)
    np.testing.assert_array_equal(np.triu(ours, 1), np.triu(a, 1))


@pytest.mark.parametrize("n", [1, 3, 6, 7])
def test_solve_inverts(n: int) -> None:
    rng = np.random.default_rng(n)
    a, b = positive_definite(rng, n), rng.normal(size=n)
    lower = np.linalg.cholesky(a)
    half, whole = b.copy(), b.copy()
    forward_solve(lower, half)
    solve(lower, whole)
    np.testing.assert_allclose(lower @ half, b, rtol=1e-10)
    np.testing.assert_allclose(whole, np.linalg.solve(a, b), rtol=1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_multiply_is_the_matrix_product(seed: int) -> None:
    a, b, out = *np.random.default_rng(seed).normal(size=(2, 3, 3)), np.zeros((3, 3))
    multiply(a.T, b, out)
    np.testing.assert_allclose(out, a.T @ b, rtol=1e-12)


# Rotations


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("length", [1e-9, 1e-3, 0.5, 3.0])
def test_rotations_are_robosuites(seed: int, length: float) -> None:
    vector = np.random.default_rng(seed).normal(size=3)
    vector *= length / np.linalg.norm(vector)
    ours = np.zeros((3, 3))
    rotation_from_vector(vector, ours)
    theirs = transform_utils.quat2mat(transform_utils.axisangle2quat(vector))
    exact = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=5e-7)
    np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-6)


def test_no_turn_is_the_identity() -> None:
    ours = np.zeros((3, 3))
    rotation_from_vector(np.zeros(3), ours)
    np.testing.assert_array_equal(ours, np.eye(3))


# Goals and errors


def placed(p: Array, rot: Array, b: Array, base: Array) -> Work:
    """A tool at p, turned by rot; the base at b, turned by base."""
    w = new_works(1, 7)[0]
    w.tool_p[:], w.tool_r[:], w.base_p[:], w.base_r[:] = p, rot, b, base
    return w


def latched(action: Array, *pose: Array) -> tuple[Array, Array]:
    w = placed(*pose)
    latch_pose_goal(action, SCALE, w)
    return w.goal_p, w.goal_r


def a_pose(seed: int) -> tuple[Array, Array, Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=3), rotation(rng), rng.normal(size=3), rotation(rng)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_action_latches_where_the_tool_is(seed: int) -> None:
    p, rot, b, base = a_pose(seed)
    goal_p, goal_r = latched(np.zeros(6), p, rot, b, base)
    np.testing.assert_allclose(b + base @ goal_p, p, atol=1e-12)
    np.testing.assert_allclose(base @ goal_r, rot, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_actions_move_the_goal_in_the_base_frame(seed: int) -> None:
    p, rot, b, base = a_pose(seed)
    action = np.random.default_rng(seed).uniform(-1, 1, 6)
    goal_p, goal_r = latched(action, p, rot, b, base)
    moved = base.T @ (p - b) + 0.05 * action[:3]
    turned = Rotation.from_rotvec(0.5 * action[3:]).as_matrix() @ base.T @ rot
    np.testing.assert_allclose(goal_p, moved, atol=1e-12)
    np.testing.assert_allclose(goal_r, turned, atol=1e-6)


def test_without_turns_the_goal_keeps_the_tools_rotation() -> None:
    w, action = placed(*a_pose(0)), np.array([1.0, -1, 0.5, 1])
    latch_pose_goal(action, SCALE[:3], w)
    goal_p, goal_r = latched(np.array([1.0, -1, 0.5, 0, 0, 0]), *a_pose(0))
    np.testing.assert_array_equal(w.goal_p, goal_p)
    np.testing.assert_array_equal(w.goal_r, goal_r)


def test_goals_are_clipped() -> None:
    pose = a_pose(0)
    sign = np.array([1.0, -1, 1, -1, 1, -1])
    for far, near in zip(latched(7 * sign, *pose), latched(sign, *pose), strict=True):
        np.testing.assert_array_equal(far, near)


def wrench(goal, pose, velocity: Array, kp: float = 150.0, kd: float = 24.0) -> Array:
    w = placed(*pose)
    w.goal_p[:], w.goal_r[:] = goal
    w.velocity[:] = velocity
    pose_error(kp, kd, w)
    return np.concatenate([w.force, w.moment])


@pytest.mark.parametrize("seed", SEEDS)
def test_at_the_goal_only_damping_acts(seed: int) -> None:
    pose = a_pose(seed)
    velocity = np.random.default_rng(seed).normal(size=6)
    result = wrench(latched(np.zeros(6), *pose), pose, velocity)
    np.testing.assert_allclose(result, -24.0 * velocity, atol=1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_away_from_the_goal_the_tool_is_pulled_to_it(seed: int) -> None:
    pose = _, _, _, base = a_pose(seed)
    action = np.random.default_rng(seed).uniform(-1, 1, 6)
    result = wrench(latched(action, *pose), pose, np.zeros(6))
    vector = base @ (0.5 * action[3:])
    angle = np.linalg.norm(vector)
    np.testing.assert_allclose(result[:3], 150 * base @ (0.05 * action[:3]), atol=1e-9)
    np.testing.assert_allclose(
        result[3:], 150 * np.sin(angle) * vector / angle, atol=1e-4
    )


# Torques


def osc(mass: Array, jac: Array, wrench: Array, pull: Array, bias: Array) -> Array:
    w = new_works(1, 7)[0]
    w.mass[:], w.jac[:], w.joint_acc[:], w.bias[:] = mass, jac, pull, bias
    w.force[:], w.moment[:] = wrench[:3], wrench[3:]
    osc_torque(w)
    return w.torque


def an_arm(seed: int) -> tuple[Array, Array, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return positive_definite(rng, 7), rng.normal(size=(6, 7)), rng


@pytest.mark.parametrize("seed", SEEDS)
def test_torques_are_robosuites(seed: int) -> None:
    mass, jac, rng = an_arm(seed)
    force, bias = rng.normal(size=6), rng.normal(size=7)
    q0, q, qd = rng.normal(size=(3, 7))
    _, linear, angular, null = opspace_matrices(mass, jac, jac[:3], jac[3:])
    theirs = jac.T @ np.concatenate([linear @ force[:3], angular @ force[3:]]) + bias
    theirs += nullspace_torques(mass, null, q0, q, qd)
    pull = NULL_KP * (q0 - q) - 2 * np.sqrt(NULL_KP) * qd
    np.testing.assert_allclose(osc(mass, jac, force, pull, bias), theirs, rtol=1e-8)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_null_space_does_not_move_the_tool(seed: int) -> None:
    mass, jac, rng = an_arm(seed)
    pull = rng.normal(size=7)
    torque = osc(mass, jac, np.zeros(6), pull, np.zeros(7))
    assert np.abs(torque).max() > 0.1
    np.testing.assert_allclose(jac @ np.linalg.solve(mass, torque), 0, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_joint_torques_give_the_desired_acceleration(seed: int) -> None:
    mass, _, rng = an_arm(seed)
    acceleration, bias = rng.normal(size=(2, 7))
    w = new_works(1, 7)[0]
    w.mass[:], w.joint_acc[:], w.bias[:] = mass, acceleration, bias
    joint_torque(w)
    result = np.linalg.solve(mass, w.torque - bias)
    np.testing.assert_allclose(result, acceleration, rtol=1e-9)


def test_gains_are_robosuites_defaults(lift_scene: Scene) -> None:
    arm = lift_scene.layout.robots[0].arm
    assert (arm.osc, arm.kp) == (True, 150.0)
    assert arm.kd == pytest.approx(2 * np.sqrt(150))
    np.testing.assert_allclose(arm.scale, SCALE)
    np.testing.assert_allclose(arm.high, [80] * 5 + [12] * 2)
    np.testing.assert_allclose(arm.low, -arm.high)
