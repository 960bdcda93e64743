"""Laws of every task: rewards, observations, milestones, starts, solvability."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import ks_2samp
from scripted import TASKS
from twin import update_memory

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Task
from manip.envs.task_registry import load_task, task_names
from manip.rewards.compose import weighted_sum
from manip.sim.batch_engine import BatchEngine
from manip.sim.robosuite_factory import reseed
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.sim.stock_reader import stock_reader
from manip.tasks.door import Door
from manip.tasks.lift import Lift
from manip.tasks.scenes.reach_scene import GOAL_HIGH, GOAL_LOW
from manip.tasks.stack import Stack

Array = np.ndarray

WORLDS = 12
RANDOM_STEPS = 15
HELD_STEPS = 10

REWARD_SETS = ("shaped", "stock")


@pytest.fixture(scope="module", params=TASKS)
def task(request) -> Task:
    return load_task(request.param)


@pytest.fixture(scope="module")
def scene(task: Task, scene_of) -> Scene:
    return scene_of(task)


class Play(NamedTuple):
    """Readings of random steps, then of scripted episodes, each [WORLDS, ...]."""

    random: list[Measures]
    scripted: list[Measures]

    def measures(self, task: Task) -> list[Measures]:
        return [task.measure(read) for read in (*self.random, *self.scripted)]


@pytest.fixture(scope="module")
def play(task: Task, scene: Scene) -> Play:
    engine, rng = BatchEngine(scene, WORLDS, threads=2), np.random.default_rng(0)
    shape = (WORLDS, scene.layout.action_dim)
    start(task, engine, episode=0)
    random, scripted = [copy(engine)], []
    for _ in range(RANDOM_STEPS):
        engine.step(rng.uniform(-1, 1, shape))
        random.append(copy(engine))
        update_memory(task, engine, np.arange(WORLDS))
    start(task, engine, episode=1)
    scripted.append(copy(engine))
    held = np.zeros(WORLDS, dtype=int)
    while held.min() < HELD_STEPS and len(scripted) <= task.horizon:
        engine.step(task.expert(task.measure(engine.read())))
        scripted.append(copy(engine))
        update_memory(task, engine, np.arange(WORLDS))
        held = (held + 1) * task.success(task.measure(engine.read()))
    assert engine.broken_count == 0
    return Play(random, scripted)


def start(task: Task, engine: BatchEngine, episode: int) -> None:
    worlds = np.arange(engine.num_envs)
    streams = EpisodeStreams(0, worlds, np.full_like(worlds, episode))
    engine.reset(worlds, *task.sample_start(engine.scene, streams))
    update_memory(task, engine, worlds)


def copy(engine: BatchEngine) -> Measures:
    return {name: values.copy() for name, values in engine.read().items()}


def imagined(read: Measures, sensors: Sensors, seed: int) -> Measures:
    """Readings that no rollout gives: objects near the tool, any angle, any touch."""
    rng, read = np.random.default_rng(seed), dict(read)
    for name in (*sensors.bodies, *sensors.sites):
        offset = rng.normal(size=(WORLDS, 3)) * 10 ** rng.uniform(-3, 0, (WORLDS, 1))
        read[f"{name}_pos"] = read["eef_pos"] + offset
    for name in sensors.joints:
        read[f"{name}_qpos"] = rng.uniform(-1.5, 1.5, (WORLDS, 1))
    for name in sensors.touches:
        read[name] = rng.integers(0, 2, WORLDS).astype(float)
    return read


@pytest.fixture(scope="module")
def all_measures(task: Task, play: Play) -> list[Measures]:
    dreams = [imagined(play.scripted[0], task.sensors, seed) for seed in range(50)]
    return play.measures(task) + [task.measure(read) for read in dreams]


# Rewards


def test_shaped_weights_add_up_to_one(task: Task) -> None:
    assert sum(task.weights["shaped"].values()) == pytest.approx(1, abs=1e-12)
    assert min(task.weights["shaped"].values()) > 0


def test_shaped_terms_are_bounded(task: Task, all_measures: list[Measures]) -> None:
    for m in all_measures:
        for name, term in task.reward_terms(m, "shaped").items():
            assert ((term >= 0) & (term <= 1)).all(), name


@pytest.mark.parametrize("reward", REWARD_SETS)
def test_rewards_are_bounded(
    reward: str, task: Task, all_measures: list[Measures]
) -> None:
    if min(task.weights[reward].values()) < 0:
        pytest.skip("robosuite's penalties have no bound")
    for m in all_measures:
        terms = task.reward_terms(m, reward)
        paid = weighted_sum(terms, task.weights[reward])
        assert paid.shape == (WORLDS,)
        assert ((paid >= 0) & (paid <= 1 + 1e-9)).all()


@pytest.mark.parametrize("reward", REWARD_SETS)
def test_every_term_is_paid_at_times(reward: str, task: Task, play: Play) -> None:
    terms = [task.reward_terms(m, reward) for m in play.measures(task)]
    for name, weight in task.weights[reward].items():
        paid = np.array([each[name] for each in terms], dtype=float)
        assert np.ptp(paid) > 0.1 or weight < 0, name


def test_the_script_earns_more_than_chance(task: Task, play: Play) -> None:
    def mean(reads: list[Measures]) -> float:
        terms = [task.reward_terms(task.measure(read), "shaped") for read in reads]
        return float(np.mean([weighted_sum(t, task.weights["shaped"]) for t in terms]))

    assert mean(play.scripted[-HELD_STEPS:]) > mean(play.random) + 0.3


# Observations


def test_observations_are_finite_and_of_order_one(
    task: Task, all_measures: list[Measures]
) -> None:
    for m in all_measures:
        for name, part in task.observe(m).items():
            assert np.isfinite(part).all(), name
            assert np.abs(part).max() < 20, name


def test_no_number_observed_is_constant(task: Task, play: Play) -> None:
    seen = [task.observe(m) for m in play.measures(task)]
    for name in seen[0]:
        values = np.concatenate([parts[name] for parts in seen])
        assert (np.ptp(values, axis=0) > 1e-4).all(), name


def test_parts_keep_their_names_and_widths(
    task: Task, all_measures: list[Measures]
) -> None:
    shapes = {
        tuple((name, part.shape) for name, part in task.observe(m).items())
        for m in all_measures
    }
    (layout,) = shapes
    assert all(len(shape) == 2 and shape[0] == WORLDS for _, shape in layout)


def test_a_world_is_observed_and_paid_alone(
    task: Task, all_measures: list[Measures], play: Play
) -> None:
    """All a task's functions are per world: none looks at its neighbours."""
    read = play.scripted[20]
    one = {name: v[3:4] if len(v) == WORLDS else v for name, v in read.items()}
    alone, together = task.measure(one), task.measure(read)
    for name, part in task.observe(alone).items():
        np.testing.assert_array_equal(part, task.observe(together)[name][3:4])
    for reward in REWARD_SETS:
        for name, term in task.reward_terms(alone, reward).items():
            whole = task.reward_terms(together, reward)[name]
            np.testing.assert_array_equal(term, whole[3:4])
    assert task.success(alone) == task.success(together)[3]


def test_measuring_leaves_the_readings(task: Task, play: Play) -> None:
    read = {name: values.copy() for name, values in play.scripted[5].items()}
    m = task.measure(read)
    task.observe(m)
    for reward in REWARD_SETS:
        task.reward_terms(m, reward)
    for name, values in play.scripted[5].items():
        np.testing.assert_array_equal(read[name], values)


# Milestones


def test_stages_are_reached_under_their_names(
    task: Task, all_measures: list[Measures]
) -> None:
    for m in all_measures:
        reached = task.milestones(m)
        assert tuple(reached) == task.milestone_names
        assert {(v.dtype, v.shape) for v in reached.values()} == {
            (np.dtype(bool), (WORLDS,))
        }


def test_success_is_the_last_stage(task: Task, all_measures: list[Measures]) -> None:
    found = np.array([task.success(m) for m in all_measures])
    last = np.array(
        [task.milestones(m)[task.milestone_names[-1]] for m in all_measures]
    )
    np.testing.assert_array_equal(found, last)
    assert found.any()
    assert not found.all()


def test_no_episode_starts_solved(task: Task, play: Play) -> None:
    for first in play.random[0], play.scripted[0]:
        m = task.measure(first)
        assert not task.success(m).any()
        assert not task.failure(m).any()


def test_the_script_solves_every_episode(task: Task, play: Play) -> None:
    found = np.array([task.success(task.measure(read)) for read in play.scripted])
    assert found[-HELD_STEPS:].all()


def test_stages_come_in_order(task: Task, play: Play) -> None:
    reached = [task.milestones(task.measure(read)) for read in play.scripted]
    flags = np.array([[at[stage] for stage in task.milestone_names] for at in reached])
    assert flags.any(axis=0).all()
    first = flags.argmax(axis=0)
    assert (np.diff(first, axis=0) >= 0).all()


def test_chance_does_not_solve_it(task: Task, play: Play) -> None:
    assert np.mean([task.success(task.measure(read)) for read in play.random]) < 0.1


# Starts


def starts(task: Task, scene: Scene, n: int) -> Array:
    """[n, nq + fields]: where n episodes start."""
    worlds = np.arange(n)
    found = task.sample_start(scene, EpisodeStreams(0, worlds, worlds))
    return np.concatenate([found.qpos, *found.fields.values()], axis=1)


def stock_starts(task: Task, scene: Scene, n: int) -> Array:
    """The same of stock robosuite's resets."""
    read, rows = stock_reader(scene.stock, task.sensors), []
    reseed(scene.stock, 0)
    for _ in range(n):
        scene.stock.reset()
        now = read()
        fields = [now[name][0] for name in task.sensors.fields]
        rows.append(np.concatenate([now["qpos"][0], *fields]))
    return np.array(rows)


def test_starts_are_distributed_as_stocks(task: Task, scene: Scene) -> None:
    ours, theirs = starts(task, scene, 400), stock_starts(task, scene, 100)
    assert ours.shape[1] == theirs.shape[1]
    for column, (a, b) in enumerate(zip(ours.T, theirs.T, strict=True)):
        if np.ptp(b) < 1e-9:
            np.testing.assert_allclose(a, b[0], atol=1e-9, err_msg=f"column {column}")
        else:
            assert ks_2samp(a, b).pvalue > 1e-3, f"column {column}"


def test_arms_start_in_the_default_pose_with_noise(task: Task, scene: Scene) -> None:
    joints = scene.layout.arm.qpos
    noise = starts(task, scene, 500)[:, joints] - scene.layout.qpos[joints]
    np.testing.assert_allclose(noise.mean(axis=0), 0, atol=0.004)
    np.testing.assert_allclose(noise.std(axis=0), 0.02, rtol=0.1)
    assert np.abs(np.corrcoef(noise.T) - np.eye(len(joints))).max() < 0.2


def test_lift_places_its_cube_as_it_says(lift: Task, lift_scene: Scene) -> None:
    cube = starts(lift, lift_scene, 500)[:, lift_scene.free_qpos("cube_main")]
    half = lift_scene.geom_size("cube_g0")[2]
    assert 0.020 <= half <= 0.022
    assert np.abs(cube[:, :2]).max() <= 0.03
    np.testing.assert_allclose(np.ptp(cube[:, :2], axis=0), 0.06, atol=0.002)
    np.testing.assert_allclose(cube[:, 2], 0.8 + 0.01 + half)
    np.testing.assert_allclose(np.linalg.norm(cube[:, 3:], axis=1), 1)
    yaw = 2 * np.arctan2(cube[:, 6], cube[:, 3]) % (2 * np.pi)
    assert np.histogram(yaw, bins=12, range=(0, 2 * np.pi))[0].min() > 20


def test_door_stands_where_it_says(door: Task, door_scene: Scene) -> None:
    found = starts(door, door_scene, 500)
    place, turn = found[:, -7:-4] - [-0.12, -0.35, 1.1], found[:, -4:]
    assert np.abs(place[:, :2]).max() <= 0.01
    np.testing.assert_allclose(np.ptp(place[:, :2], axis=0), 0.02, atol=0.001)
    np.testing.assert_allclose(place[:, 2], 0, atol=1e-12)
    yaw = np.rad2deg(2 * np.arctan2(turn[:, 3], turn[:, 0]))
    assert -90 - np.rad2deg(0.25) <= yaw.min() < yaw.max() <= -90
    assert np.ptp(yaw) > 14


def test_stack_places_its_cubes_apart(scene_of) -> None:
    task = Stack()
    scene = scene_of(task)
    found = starts(task, scene, 500)
    a, b = (found[:, scene.free_qpos(f"cube{name}_main")] for name in "AB")
    radii = np.sqrt(2) * (0.02 + 0.025)
    assert radii < np.linalg.norm(a[:, :2] - b[:, :2], axis=1).min() < radii + 0.003
    for cube, half in (a, 0.02), (b, 0.025):
        np.testing.assert_allclose(np.abs(cube[:, :2]).max(axis=0), 0.08, atol=0.002)
        np.testing.assert_allclose(cube[:, 2], 0.8 + 0.01 + half)


def test_reach_draws_its_goals_in_the_box(reach: Task, reach_scene: Scene) -> None:
    goals = starts(reach, reach_scene, 500)[:, -3:]
    assert ((goals >= GOAL_LOW) & (goals <= GOAL_HIGH)).all()
    np.testing.assert_allclose(goals.min(axis=0), GOAL_LOW, atol=0.01)
    np.testing.assert_allclose(goals.max(axis=0), GOAL_HIGH, atol=0.01)


# What a task is called


def test_a_tasks_name_is_the_one_it_is_loaded_by() -> None:
    assert {"Door", "Lift", "Reach"} <= set(task_names())
    for name in task_names():
        assert load_task(name).name == name


# Numbers stated in a task's docstring


def test_door_pays_as_its_docstring_says() -> None:
    handle = np.tile([0.0, -0.25, 1.07], (6, 1))
    read = {
        "handle_pos": handle,
        "eef_pos": handle + np.outer([0.2, 0, 0, 0, 0, 0.2], [0, 1, 0]),
        "handle_qpos": np.array([[0, 0.6, -1.2, 0, 0, 0]]).T,
        "hinge_qpos": np.array([[0, 0, 0, 0.101, 0.29, 0.35]]).T,
        "door_turn": np.tile([1.0, 0, 0, 0], (6, 1)),
    }
    task = Door()
    m = task.measure(read)
    shaped = weighted_sum(task.reward_terms(m, "shaped"), task.weights["shaped"])
    far = 1 - np.tanh(1)
    level = [0.1 * far, 0.1 + 0.1, 0.1 + 0.2]
    ajar = [0.3 + 0.4 * 0.101 / 0.35, 0.3 + 0.4 * 0.29 / 0.35, 1]
    np.testing.assert_allclose(shaped, level + ajar)
    assert task.success(m).tolist() == [False] * 5 + [True]
    stock = weighted_sum(task.reward_terms(m, "stock"), task.weights["stock"])
    turned = [0.25 + 0.25 * angle / (np.pi / 2) for angle in (0.6, 1.2)]
    expected = [0.25 * (1 - np.tanh(2)), *turned, 0.25, 0.25, 1]
    np.testing.assert_allclose(stock, expected)


def test_stack_pays_as_its_docstring_says_and_more_each_stage() -> None:
    b, above = np.array([0.1, 0.0, 0.825]), 0.045
    lying, lifted = [-0.1, 0.0, 0.82], [-0.1, 0.0, 0.845]
    offsets = [[0, 0, above + 0.05], [0, 0, above + 0.001], *[[0, 0, above]] * 3]
    a = np.vstack([[lying] * 3, lifted, b + offsets])
    far, closing = [0.2, *[0.0] * 7, 0.06], [-1, -1, 1, 1, 1, 1, 1, 0, -1]
    read = {
        "a_pos": a,
        "b_pos": np.tile(b, (9, 1)),
        "eef_pos": a + np.outer(far, [0, 0, 1]),
        "left_touch": np.array([0.0, 0, 1, 1, 1, 1, 1, 1, 0]),
        "right_touch": np.array([0.0, 1, 1, 1, 1, 1, 1, 1, 0]),
        "cubes_touch": np.array([0.0, 0, 0, 0, 0, 0, 1, 1, 1]),
        "gripper_closing": np.array(closing, dtype=float),
    }
    task = Stack()
    m = task.measure(read)
    shaped = weighted_sum(task.reward_terms(m, "shaped"), task.weights["shaped"])
    aside, tanh = 0.2, np.tanh
    half_up = 0.16 + 0.04 + 0.08 * (1 - tanh(6 * aside))
    held = [0.08 * (1 - tanh(1)), 0.08, 0.16, half_up, 0.4, 0.4 + 0.1176]
    np.testing.assert_allclose(shaped, [*held, 0.57, 0.635, 1])
    assert (np.diff(shaped) > 0).all()
    assert task.success(m).tolist() == [False] * 8 + [True]
    stock = weighted_sum(task.reward_terms(m, "stock"), task.weights["stock"])
    low = [0.125 * (1 - tanh(2)), 0.125, 0.25, 0.5 + 0.25 * (1 - tanh(aside))]
    np.testing.assert_allclose(stock, [*low, *[0.75] * 4, 1])


def test_lift_pays_as_its_docstring_says() -> None:
    height = np.array([0.021, 0.021, 0.0399, 0.0401, 0.2, 0.021, 0.2])
    cube = np.outer(0.8 + height, [0, 0, 1])
    above = [0.2, 0, 0, 0, 0.012, 0.018, 0.021]
    read = {
        "cube_pos": cube,
        "eef_pos": cube + np.outer(above, [0, 0, 1]),
        "left_touch": np.array([1.0, 0, 1, 1, 1, 1, 1]),
        "right_touch": np.array([0.0, 0, 1, 1, 1, 1, 1]),
        "gripper_closing": np.ones(7),
    }
    task = Lift()
    m = task.measure(read)
    terms = task.reward_terms(m, "shaped")
    np.testing.assert_allclose(terms["reach"], 1 - np.tanh(5 * np.array(above)))
    np.testing.assert_allclose(terms["grasp"], [0, 0, 1, 1, 1, 0.25, 0], atol=1e-9)
    np.testing.assert_allclose(terms["lift"], [0, 0, 0.378, 0.382, 1, 0, 1], atol=1e-9)
    assert task.success(m).tolist() == [False] * 3 + [True] * 2 + [False, True]
    stock = weighted_sum(task.reward_terms(m, "stock"), task.weights["stock"])
    low = (1.25 - np.tanh(0.18)) / 2.25
    expected = [(1 - np.tanh(2)) / 2.25, 1 / 2.25, 1.25 / 2.25, 1, 1, low, 1]
    np.testing.assert_allclose(stock, expected)
