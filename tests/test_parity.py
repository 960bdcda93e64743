"""The batch engine and stock robosuite are the same process, step by step."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scripted import SCRIPTS
from twin import reading, start_twin

from manip.envs.task import Task
from manip.rewards.compose import weighted_sum
from manip.sim.engine import BatchEngine
from manip.sim.model import Scene, load_scene
from manip.sim.stock import CONTROL_FREQUENCIES, CONTROLLERS, ROBOTS

Array = np.ndarray

JOINT_TOLERANCE = {"OSC_POSE": 1e-5, "JOINT_POSITION": 1e-12}
"""Largest joint difference [rad] after 50 random steps."""

WORLD = 37


class Moment(NamedTuple):
    """The same instant in stock robosuite and in a world of the engine [1, ...]."""

    stock: dict[str, Array]
    read: dict[str, Array]
    reward: float
    success: bool
    both_pads: bool


Act = Callable[[dict[str, Array], int], Array]


def play(
    task: Task, engine: BatchEngine, world: int, seed: int, act: Act, steps: int
) -> Iterator[Moment]:
    """Take the same actions in stock and in one world; the others act at random."""
    stock = engine.scene.stock
    start_twin(task, engine, [world], seed)
    rng = np.random.default_rng(seed)
    for step in range(steps):
        action = act(reading(engine, world), step)
        actions = rng.uniform(-1, 1, (engine.num_worlds, action.shape[1]))
        actions[world] = action[0]
        found, reward, _, _ = stock.step(action[0])
        engine.step(actions)
        yield Moment(
            found,
            reading(engine, world),
            reward,
            bool(stock._check_success()),
            both_pads_touch(stock),
        )


def both_pads_touch(stock: Any) -> bool:
    cube = getattr(stock, "cube", None)
    if cube is None:
        return False
    return bool(stock._check_grasp(stock.robots[0].gripper["right"], cube))


def random_actions(scene: Scene, seed: int) -> Act:
    rng = np.random.default_rng(seed)
    return lambda read, step: rng.uniform(-1, 1, (1, scene.handles.action_dim))


def scripted_actions(task: Task) -> Act:
    return lambda read, step: SCRIPTS[task.name](task.measure(read))


Trace = list[Moment]


@pytest.fixture(scope="module", params=CONTROLLERS)
def random_trace(request, scene_of, lift: Task) -> tuple[str, Scene, Trace]:
    """50 random steps in world 37 of 64, then a reset of it alone and 10 steps more."""
    scene = scene_of(lift, controller=request.param)
    engine = BatchEngine(scene, 64, threads=2)
    act = random_actions(scene, seed=0)
    trace = [
        *play(lift, engine, WORLD, 7, act, 50),
        *play(lift, engine, WORLD, 8, act, 10),
    ]
    return request.param, scene, trace


@pytest.fixture(scope="module")
def lift_trace(lift: Task, lift_scene: Scene) -> Trace:
    engine = BatchEngine(lift_scene, 1)
    return list(play(lift, engine, 0, 1, scripted_actions(lift), 45))


@pytest.fixture(scope="module")
def reach_trace(reach: Task, reach_scene: Scene) -> Trace:
    engine = BatchEngine(reach_scene, 3)
    return list(play(reach, engine, 1, 2, scripted_actions(reach), 40))


def test_joints_follow_stock(random_trace) -> None:
    controller, _, trace = random_trace
    moved = np.ptp([at.stock["robot0_joint_pos"] for at in trace], axis=0)
    gaps = [at.read["joint_pos"][0] - at.stock["robot0_joint_pos"] for at in trace]
    assert moved.max() > 0.05
    assert np.abs(gaps).max() <= JOINT_TOLERANCE[controller]


def wxyz_to_xyzw(quaternion: Array) -> Array:
    return quaternion[[1, 2, 3, 0]]


READINGS: dict[str, Callable[[dict[str, Array], Scene], Array]] = {
    "robot0_joint_pos": lambda r, s: r["joint_pos"][0],
    "robot0_joint_vel": lambda r, s: r["joint_vel"][0],
    "robot0_joint_acc": lambda r, s: r["qacc"][0, s.handles.arm.dof],
    "robot0_eef_pos": lambda r, s: r["eef_pos"][0],
    "robot0_eef_quat": lambda r, s: wxyz_to_xyzw(r["hand_quat"][0]),
    "robot0_gripper_qpos": lambda r, s: r["gripper_qpos"][0],
    "robot0_gripper_qvel": lambda r, s: r["gripper_qvel"][0],
    "cube_pos": lambda r, s: r["cube_pos"][0],
    "cube_quat": lambda r, s: wxyz_to_xyzw(r["cube_quat"][0]),
    "gripper_to_cube_pos": lambda r, s: r["cube_pos"][0] - r["eef_pos"][0],
}


@pytest.mark.parametrize("name", READINGS)
def test_readings_are_stock_observations(name: str, random_trace) -> None:
    _, scene, trace = random_trace
    ours = [READINGS[name](at.read, scene) for at in trace]
    theirs = [at.stock[name] for at in trace]
    np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-5)


def test_a_reset_reads_as_stocks(lift: Task, lift_scene: Scene) -> None:
    engine = BatchEngine(lift_scene, 2, threads=1)
    engine.step(np.ones((2, 7)))
    found = start_twin(lift, engine, [0], seed=5)
    for name, read in READINGS.items():
        ours = read(reading(engine, 0), lift_scene)
        np.testing.assert_allclose(ours, found[name], rtol=0, atol=1e-12, err_msg=name)


def test_grip_site_is_turned_as_in_stock(random_trace) -> None:
    _, _, trace = random_trace
    ours = Rotation.from_matrix([at.read["eef_mat"].reshape(3, 3) for at in trace])
    theirs = Rotation.from_quat([at.stock["robot0_eef_quat_site"] for at in trace])
    assert (ours * theirs.inv()).magnitude().max() < 1e-5


def stock_reward(task: Task, at: Moment) -> float:
    terms = task.reward_terms(task.measure(at.read), "stock")
    return float(weighted_sum(terms, task.weights["stock"])[0])


def test_stock_reward_of_random_actions_is_robosuites(random_trace, lift: Task) -> None:
    _, _, trace = random_trace
    ours = [stock_reward(lift, at) for at in trace]
    np.testing.assert_allclose(ours, [at.reward for at in trace], rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["lift", "reach"])
def test_stock_reward_of_an_episode_is_robosuites(name: str, request) -> None:
    task, trace = (request.getfixturevalue(f) for f in (name, f"{name}_trace"))
    ours = [stock_reward(task, at) for at in trace]
    np.testing.assert_allclose(ours, [at.reward for at in trace], rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["lift", "reach"])
def test_success_comes_when_stock_says_so(name: str, request) -> None:
    task, trace = (request.getfixturevalue(f) for f in (name, f"{name}_trace"))
    ours = [bool(task.success(task.measure(at.read))[0]) for at in trace]
    assert ours == [at.success for at in trace]
    assert (ours[0], ours[-1]) == (False, True)


def test_touching_pads_are_stocks_grasp(lift_trace: Trace) -> None:
    ours = [bool(at.read["left_touch"] * at.read["right_touch"]) for at in lift_trace]
    assert ours == [at.both_pads for at in lift_trace]
    assert (ours[0], ours[-1]) == (False, True)


def test_a_carried_cube_stays_where_stock_has_it(lift_trace: Trace) -> None:
    last = lift_trace[-1]
    assert last.stock["cube_pos"][2] > 0.84
    np.testing.assert_allclose(last.read["cube_pos"][0], last.stock["cube_pos"], 1e-5)


def test_the_goal_is_stocks(reach_trace: Trace) -> None:
    for at in reach_trace[0], reach_trace[-1]:
        np.testing.assert_array_equal(at.read["goal_pos"][0], at.stock["goal_pos"])


@pytest.mark.slow
@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_every_arm_lifts_as_in_stock(robot: str, controller: str, lift: Task) -> None:
    scene = load_scene("Lift", lift.sensors, robot, controller, seed=3)
    assert_follows_stock(lift, scene, steps=10)


@pytest.mark.slow
@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_every_arm_reaches_as_in_stock(
    robot: str, controller: str, reach: Task
) -> None:
    scene = load_scene("Reach", reach.sensors, robot, controller)
    assert_follows_stock(reach, scene, steps=10)


@pytest.mark.slow
@pytest.mark.parametrize("control_freq", CONTROL_FREQUENCIES)
def test_every_control_frequency_follows_stock(control_freq: int, lift: Task) -> None:
    scene = load_scene("Lift", lift.sensors, control_freq=control_freq, seed=3)
    assert_follows_stock(lift, scene, steps=20)


def assert_follows_stock(task: Task, scene: Scene, steps: int) -> None:
    """The arm does; fingers in a closed chain (Robotiq) amplify rounding too fast."""
    act = random_actions(scene, seed=0)
    for at in play(task, BatchEngine(scene, 2), 1, 4, act, steps):
        for name in "robot0_joint_pos", "robot0_eef_pos":
            ours = READINGS[name](at.read, scene)
            np.testing.assert_allclose(ours, at.stock[name], rtol=0, atol=1e-5)
