"""The batch engine and stock robosuite are the same process, step by step."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scripted import TASKS
from stock_readings import OBJECT_READINGS, robot_readings
from twin import RESYNCED, copy_state, reading, start_twin, update_memory

from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.rewards.compose import weighted_sum
from manip.robot_config import CONTROL_FREQUENCIES, CONTROLLERS, ROBOTS, RobotConfig
from manip.sim.batch_engine import BatchEngine
from manip.sim.robot_model import reading_prefix
from manip.sim.scene import Scene, load_scene
from manip.sim.stock_reader import stock_reader

Array = np.ndarray

JOINT_TOLERANCE = {"OSC_POSE": 1e-5, "OSC_POSITION": 1e-10, "JOINT_POSITION": 1e-12}
"""Largest joint difference [rad] after 50 random steps."""

OBJECT_TOLERANCE = {"PickPlace": 2e-4}
"""Largest difference of an object's pose (m, or of a quaternion), where it is not 1e-5:
contacts among several objects amplify differences within a control step."""

CLEAR_STEPS = {"TwoArmPegInHole": 30}
"""Random steps, where it is not 50: in the next one the plate hits the mount of its own
robot, which turns differences of 1e-7 rad/s into 1e-4."""

NUM_ENVS, ENV_ID = 12, 7

SUCCESS_STEPS = 10


class TimeStep(NamedTuple):
    """The same instant in stock robosuite and in an environment of the engine [1, ...].

    `read` also holds what was read a step ago, under names that begin with last_.
    """

    stock: dict[str, Array]
    read: dict[str, Array]
    reward: float
    success: bool
    touches: dict[str, Array]
    both_pads: bool


Act = Callable[[dict[str, Array], int], Array]


def play(
    task: Task,
    engine: BatchEngine,
    env_id: int,
    seed: int,
    act: Act,
    steps: int,
    resync: int | None = None,
) -> Iterator[TimeStep]:
    """Take the same actions in stock and one environment; others act at random."""
    stock = engine.scene.stock
    start_twin(task, engine, [env_id], seed)
    read_stock = stock_reader(stock, task.sensors)
    rng = np.random.default_rng(seed)
    for step in range(steps):
        if resync and step % resync == 0:
            copy_state(task, engine, [env_id])
        last = reading(engine, env_id)
        action = act(last, step)
        actions = rng.uniform(-1, 1, (engine.num_envs, action.shape[1]))
        actions[env_id] = action[0]
        observation, reward, _, _ = stock.step(action[0])
        engine.step(actions)
        now = TimeStep(
            observation,
            reading(engine, env_id) | {f"last_{name}": last[name] for name in last},
            reward,
            bool(stock._check_success()),
            {name: read_stock()[name] for name in contacts(task)},
            both_pads_touch(stock),
        )
        update_memory(task, engine, np.arange(engine.num_envs))
        yield now


def contacts(task: Task) -> tuple[str, ...]:
    return *task.sensors.touches, *task.sensors.counts


def both_pads_touch(stock: Any) -> bool:
    cube = getattr(stock, "cube", None)
    if cube is None:
        return False
    return bool(stock._check_grasp(stock.robots[0].gripper["right"], cube))


def random_actions(scene: Scene, seed: int) -> Act:
    rng = np.random.default_rng(seed)
    return lambda read, step: rng.uniform(-1, 1, (1, scene.layout.action_dim))


def expert_actions(task: Task) -> Act:
    return lambda read, step: task.expert(task.measure(read))


Trace = list[TimeStep]


RANDOM_RUNS = (
    *(("Lift", controller) for controller in CONTROLLERS),
    ("Door", "OSC_POSE"),
    ("NutAssembly", "OSC_POSE"),
    ("NutAssemblyRound", "OSC_POSE"),
    ("NutAssemblySquare", "OSC_POSE"),
    ("PickGoal", "OSC_POSE"),
    ("PickPlace", "OSC_POSE"),
    ("PickPlaceBread", "OSC_POSE"),
    ("PickPlaceCan", "OSC_POSE"),
    ("PickPlaceCereal", "OSC_POSE"),
    ("PickPlaceMilk", "OSC_POSE"),
    ("Push", "OSC_POSE"),
    ("Stack", "OSC_POSE"),
    ("ToolHang", "OSC_POSE"),
    *(("TwoArmLift", controller) for controller in CONTROLLERS),
    ("TwoArmPegInHole", "OSC_POSE"),
    ("Wipe", "OSC_POSE"),
)


class Run(NamedTuple):
    """A task, played in stock and in the engine."""

    task: Task
    scene: Scene
    trace: list[TimeStep]


@pytest.fixture(scope="module", params=RANDOM_RUNS, ids="-".join)
def random_run(request, scene_of) -> Run:
    """50 random steps in environment 7 of 12, a reset of it alone, 10 steps more."""
    task, controller = load_task(request.param[0]), request.param[1]
    scene = scene_of(task, controller=controller)
    engine = BatchEngine(scene, NUM_ENVS, threads=2)
    act = random_actions(scene, seed=0)
    trace = [
        *play(task, engine, ENV_ID, 7, act, CLEAR_STEPS.get(task.name, 50)),
        *play(task, engine, ENV_ID, 8, act, 10),
    ]
    return Run(task, scene, trace)


@pytest.fixture(scope="module", params=TASKS)
def expert_run(request, scene_of) -> Run:
    """An episode of the expert, until its success has lasted for a while."""
    task = load_task(request.param)
    scene = scene_of(task)
    act, resync = expert_actions(task), RESYNCED.get(task.name)
    steps = play(task, BatchEngine(scene, 1), 0, 2, act, task.horizon, resync)
    trace, successes = [], 0
    while successes < SUCCESS_STEPS:
        trace.append(next(steps))
        successes = (successes + 1) * trace[-1].success
    return Run(task, scene, trace)


@pytest.fixture(scope="module")
def lift_trace(lift: Task, lift_scene: Scene) -> list[TimeStep]:
    engine = BatchEngine(lift_scene, 1)
    return list(play(lift, engine, 0, 1, expert_actions(lift), 45))


def test_joints_follow_stock(random_run: Run) -> None:
    _, scene, trace = random_run
    for number, robot in enumerate(scene.stock.robots):
        name, ours = f"robot{number}_joint_pos", f"{reading_prefix(number)}joint_pos"
        controller = robot.part_controllers["right"].name
        moved = np.ptp([at.stock[name] for at in trace], axis=0)
        gaps = [at.read[ours][0] - at.stock[name] for at in trace]
        assert moved.max() > 0.05
        assert np.abs(gaps).max() <= JOINT_TOLERANCE[controller]


def assert_reads_as_stock(run: Run, **tolerance: float) -> None:
    readings = robot_readings(run.scene) | OBJECT_READINGS[run.task.name]
    for name, read in readings.items():
        ours = [read(at.read, run.scene) for at in run.trace]
        theirs = [at.stock[name] for at in run.trace]
        np.testing.assert_allclose(ours, theirs, err_msg=name, **tolerance)


def test_readings_are_stock_observations(random_run: Run) -> None:
    assert_reads_as_stock(random_run, rtol=1e-5, atol=1e-5)


def test_every_observation_of_stocks_objects_is_compared(expert_run: Run) -> None:
    sensed = expert_run.scene.stock._observables.items()
    names = {name for name, s in sensed if s.modality == "object" and s.is_active()}
    assert names == OBJECT_READINGS[expert_run.task.name].keys()


def test_a_reset_reads_as_stocks(expert_run: Run) -> None:
    task, scene, _ = expert_run
    engine = BatchEngine(scene, 2, threads=1)
    engine.step(np.ones((2, scene.layout.action_dim)))
    observation = start_twin(task, engine, [0], seed=5)
    now = TimeStep(observation, reading(engine, 0), 0.0, False, {}, False)
    assert_reads_as_stock(Run(task, scene, [now]), rtol=0, atol=1e-7)


def test_grip_site_is_turned_as_in_stock(random_run: Run) -> None:
    trace = random_run.trace
    for number in range(len(random_run.scene.layout.robots)):
        name, site = f"{reading_prefix(number)}eef_mat", f"robot{number}_eef_quat_site"
        ours = Rotation.from_matrix([at.read[name].reshape(3, 3) for at in trace])
        theirs = Rotation.from_quat([at.stock[site] for at in trace])
        assert (ours * theirs.inv()).magnitude().max() < 1e-5


def assert_pays_as_stock(run: Run) -> None:
    task, weights = run.task, run.task.weights["stock"]
    measured = [task.measure(at.read) for at in run.trace]
    ours = [weighted_sum(task.reward_terms(m, "stock"), weights)[0] for m in measured]
    theirs = [at.reward for at in run.trace]
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-5)


def test_stock_reward_of_random_actions_is_robosuites(random_run: Run) -> None:
    assert_pays_as_stock(random_run)


def test_stock_reward_of_an_episode_is_robosuites(expert_run: Run) -> None:
    assert_pays_as_stock(expert_run)


def test_success_comes_when_stock_says_so(expert_run: Run) -> None:
    task, trace = expert_run.task, expert_run.trace
    ours = [bool(task.success(task.measure(at.read))[0]) for at in trace]
    assert ours == [at.success for at in trace]
    assert (ours[0], ours[-1]) == (False, True)


def test_objects_follow_stock_through_an_episode(expert_run: Run) -> None:
    name = expert_run.task.name
    atol = OBJECT_TOLERANCE.get(name, 1e-5)
    for at in expert_run.trace:
        for key, read in OBJECT_READINGS[name].items():
            ours, theirs = read(at.read, expert_run.scene), at.stock[key]
            if key.endswith("quat"):
                ours = ours * np.sign(ours @ theirs)  # q and -q are the same turn
            np.testing.assert_allclose(ours, theirs, 1e-4, atol, err_msg=key)


def test_touches_are_stocks(expert_run: Run) -> None:
    for name in contacts(expert_run.task):
        ours = [at.read[name][0] for at in expert_run.trace]
        assert ours == [at.touches[name][0] for at in expert_run.trace], name


def test_touching_pads_are_stocks_grasp(lift_trace: list[TimeStep]) -> None:
    ours = [bool(at.read["left_touch"] * at.read["right_touch"]) for at in lift_trace]
    assert ours == [at.both_pads for at in lift_trace]
    assert (ours[0], ours[-1]) == (False, True)


@pytest.mark.slow
@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_every_arm_lifts_as_in_stock(robot: str, controller: str, lift: Task) -> None:
    scene = load_scene("Lift", lift.sensors, RobotConfig(robot, controller), seed=3)
    assert_follows_stock(lift, scene, steps=10)


@pytest.mark.slow
@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_every_arm_reaches_as_in_stock(
    robot: str, controller: str, reach: Task
) -> None:
    scene = load_scene("Reach", reach.sensors, RobotConfig(robot, controller))
    assert_follows_stock(reach, scene, steps=10)


@pytest.mark.slow
@pytest.mark.parametrize("control_freq", CONTROL_FREQUENCIES)
def test_every_control_frequency_follows_stock(control_freq: int, lift: Task) -> None:
    scene = load_scene(
        "Lift", lift.sensors, RobotConfig(control_freq=control_freq), seed=3
    )
    assert_follows_stock(lift, scene, steps=20)


def assert_follows_stock(task: Task, scene: Scene, steps: int) -> None:
    """The arm does; fingers in a closed chain (Robotiq) amplify rounding too fast."""
    act = random_actions(scene, seed=0)
    for at in play(task, BatchEngine(scene, 2), 1, 4, act, steps):
        for name in "robot0_joint_pos", "robot0_eef_pos":
            ours = robot_readings(scene)[name](at.read, scene)
            np.testing.assert_allclose(ours, at.stock[name], rtol=0, atol=1e-5)
