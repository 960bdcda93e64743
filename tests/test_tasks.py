"""Laws of every task: rewards, observations, milestones, solvability by its expert."""

from typing import NamedTuple

import numpy as np
import pytest
from scripted import ALL_TASKS
from twin import update_memory

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.observation_formulas import observation_formulas
from manip.envs.task import Measures, Task
from manip.envs.task_registry import load_task, task_names
from manip.rewards.compose import weighted_sum
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors

Array = np.ndarray

NUM_ENVS = 6
RANDOM_STEPS = 15
SUCCESS_STEPS = 10
"""Number of last steps of an expert's rollout that must all be successful."""

REWARD_SETS = ("shaped", "stock")


@pytest.fixture(scope="module", params=ALL_TASKS)
def task(request) -> Task:
    return load_task(request.param)


@pytest.fixture(scope="module")
def scene(task: Task, scene_of) -> Scene:
    return scene_of(task)


class Rollouts(NamedTuple):
    """Measures of random steps, then of episodes of the expert, each [NUM_ENVS, ...].

    readings: what the sensors read in the expert's episodes.
    """

    random: list[Measures]
    expert: list[Measures]
    readings: list[Measures]

    @property
    def measures(self) -> list[Measures]:
        return [*self.random, *self.expert]


@pytest.fixture(scope="module")
def rollouts(task: Task, scene: Scene) -> Rollouts:
    engine = BatchEngine(scene, NUM_ENVS, threads=2)
    random = [task.measure(read) for read in random_readings(task, engine)]
    readings = expert_readings(task, engine)
    assert engine.broken_count == 0
    return Rollouts(random, [task.measure(read) for read in readings], readings)


def random_readings(task: Task, engine: BatchEngine) -> list[Measures]:
    rng = np.random.default_rng(0)
    start(task, engine, episode=0)
    readings = [copy(engine)]
    for _ in range(RANDOM_STEPS):
        engine.step(rng.uniform(-1, 1, (NUM_ENVS, engine.scene.layout.action_dim)))
        readings.append(copy(engine))
        update_memory(task, engine, np.arange(NUM_ENVS))
    return readings


def expert_readings(task: Task, engine: BatchEngine) -> list[Measures]:
    """Readings until all environments have been successful for SUCCESS_STEPS."""
    start(task, engine, episode=1)
    readings, successes = [copy(engine)], np.zeros(NUM_ENVS, dtype=int)
    m = task.measure(readings[-1])
    while successes.min() < SUCCESS_STEPS and len(readings) <= task.horizon:
        engine.step(task.expert(m))
        readings.append(copy(engine))
        update_memory(task, engine, np.arange(NUM_ENVS))
        m = task.measure(copy(engine))
        successes = (successes + 1) * task.success(m)
    return readings


def start(task: Task, engine: BatchEngine, episode: int) -> None:
    env_ids = np.arange(engine.num_envs)
    streams = EpisodeStreams(0, env_ids, np.full_like(env_ids, episode))
    engine.reset(env_ids, *task.sample_start(engine.scene, streams))
    update_memory(task, engine, env_ids)


def copy(engine: BatchEngine) -> Measures:
    return {name: values.copy() for name, values in engine.read().items()}


def imagined(read: Measures, sensors: Sensors, seed: int) -> Measures:
    """Readings that no rollout gives: objects near the tool, any angle, any touch."""
    rng, read = np.random.default_rng(seed), dict(read)
    for name in (*sensors.bodies, *sensors.sites):
        offset = rng.normal(size=(NUM_ENVS, 3)) * 10 ** rng.uniform(
            -3, 0, (NUM_ENVS, 1)
        )
        read[f"{name}_pos"] = read["eef_pos"] + offset
    for name in sensors.joints:
        read[f"{name}_qpos"] = rng.uniform(-1.5, 1.5, (NUM_ENVS, 1))
    for name in sensors.touches:
        read[name] = rng.integers(0, 2, NUM_ENVS).astype(float)
    return read


@pytest.fixture(scope="module")
def all_measures(task: Task, rollouts: Rollouts) -> list[Measures]:
    first = rollouts.readings[0]
    reads = [imagined(first, task.sensors, seed) for seed in range(50)]
    return rollouts.measures + [task.measure(read) for read in reads]


# Rewards


def test_shaped_weights_add_up_to_one(task: Task) -> None:
    assert sum(task.weights["shaped"].values()) == pytest.approx(1, abs=1e-12)
    assert min(task.weights["shaped"].values()) >= 0
    optional = {name for name, weight in task.weights["shaped"].items() if not weight}
    assert optional == ({"upright"} if task.name == "Lift" else set())


def test_shaped_terms_are_bounded(task: Task, all_measures: list[Measures]) -> None:
    for m in all_measures:
        for name, term in task.reward_terms(m, "shaped").items():
            assert ((term >= 0) & (term <= 1)).all(), name


@pytest.mark.parametrize("reward", REWARD_SETS)
def test_rewards_are_bounded(
    reward: str, task: Task, all_measures: list[Measures]
) -> None:
    if min(task.weights[reward].values()) < 0:
        pytest.skip("robosuite's penalties are not bounded")
    for m in all_measures:
        terms = task.reward_terms(m, reward)
        value = weighted_sum(terms, task.weights[reward])
        assert value.shape == (NUM_ENVS,)
        assert ((value >= 0) & (value <= 1 + 1e-9)).all()


@pytest.mark.parametrize("reward", REWARD_SETS)
def test_every_term_varies(reward: str, task: Task, rollouts: Rollouts) -> None:
    terms = [task.reward_terms(m, reward) for m in rollouts.measures]
    for name, weight in task.weights[reward].items():
        values = np.array([each[name] for each in terms], dtype=float)
        assert np.ptp(values) > 0.1 or weight < 0, name


def test_the_expert_earns_more_than_random_actions(
    task: Task, rollouts: Rollouts
) -> None:
    def mean(measures: list[Measures]) -> float:
        terms = [task.reward_terms(m, "shaped") for m in measures]
        return float(np.mean([weighted_sum(t, task.weights["shaped"]) for t in terms]))

    assert mean(rollouts.expert[-SUCCESS_STEPS:]) > mean(rollouts.random) + 0.3


# Observations


def test_observations_are_finite_and_of_order_one(
    task: Task, all_measures: list[Measures]
) -> None:
    for m in all_measures:
        for name, part in task.observe(m).items():
            assert np.isfinite(part).all(), name
            assert np.abs(part).max() < 20, name


def test_no_observed_number_is_constant(
    task: Task, all_measures: list[Measures]
) -> None:
    observed = [task.observe(m) for m in all_measures]
    for name in observed[0]:
        values = np.concatenate([parts[name] for parts in observed])
        assert (np.ptp(values, axis=0) > 1e-4).all(), name


def test_parts_keep_their_names_and_widths(
    task: Task, all_measures: list[Measures]
) -> None:
    shapes = {
        tuple((name, part.shape) for name, part in task.observe(m).items())
        for m in all_measures
    }
    (layout,) = shapes
    assert all(len(shape) == 2 and shape[0] == NUM_ENVS for _, shape in layout)


def test_proprioception_does_not_depend_on_objects(
    task: Task, rollouts: Rollouts
) -> None:
    """Objects elsewhere change other parts, but no part of the proprioception."""
    first = rollouts.readings[0]
    fields = {name: first[name][::-1] for name in task.sensors.fields}
    elsewhere = {**imagined(first, task.sensors, seed=0), **fields}
    parts, moved = (task.observe(task.measure(read)) for read in (first, elsewhere))
    same = {name for name in parts if np.array_equal(parts[name], moved[name])}
    assert set(task.proprioception) <= same
    assert same < parts.keys()


def test_each_environment_is_observed_and_rewarded_alone(
    task: Task, rollouts: Rollouts
) -> None:
    """No function mixes rows: one row gives the same numbers as in a batch."""
    read = rollouts.readings[20]
    row = {name: v[3:4] if len(v) == NUM_ENVS else v for name, v in read.items()}
    alone, together = task.measure(row), task.measure(read)
    for name, part in task.observe(alone).items():
        np.testing.assert_array_equal(part, task.observe(together)[name][3:4])
    for reward in REWARD_SETS:
        for name, term in task.reward_terms(alone, reward).items():
            whole = task.reward_terms(together, reward)[name]
            np.testing.assert_array_equal(term, whole[3:4])
    assert task.success(alone) == task.success(together)[3]


def test_measuring_does_not_change_the_readings(task: Task, rollouts: Rollouts) -> None:
    read = {name: values.copy() for name, values in rollouts.readings[5].items()}
    m = task.measure(read)
    task.observe(m)
    task.expert(m)
    for reward in REWARD_SETS:
        task.reward_terms(m, reward)
    for name, values in rollouts.readings[5].items():
        np.testing.assert_array_equal(read[name], values)


NO_FORMULA = {"NutAssembly", "PickPlace", "Wipe", "TwoArmLift", "TwoArmPegInHole"}
"""Tasks with parts that depend on memory, on many bodies, or on two robots."""


def test_every_observed_part_has_a_formula(task: Task, rollouts: Rollouts) -> None:
    read = rollouts.readings[0]
    parts = task.observe(task.measure(read)).keys()
    if task.name not in NO_FORMULA:
        assert observation_formulas(task, read).keys() == parts


# Milestones and success


def test_milestones_have_the_declared_names_and_types(
    task: Task, all_measures: list[Measures]
) -> None:
    for m in all_measures:
        milestones = task.milestones(m)
        assert tuple(milestones) == task.milestone_names
        assert {(v.dtype, v.shape) for v in milestones.values()} == {
            (np.dtype(bool), (NUM_ENVS,))
        }


def test_success_is_the_last_milestone(
    task: Task, all_measures: list[Measures]
) -> None:
    success = np.array([task.success(m) for m in all_measures])
    last = [task.milestones(m)[task.milestone_names[-1]] for m in all_measures]
    np.testing.assert_array_equal(success, last)
    assert success.any()
    assert not success.all()


def test_no_episode_starts_successful(task: Task, rollouts: Rollouts) -> None:
    for m in rollouts.random[0], rollouts.expert[0]:
        assert not task.success(m).any()
        assert not task.failure(m).any()


def test_the_expert_solves_every_episode(task: Task, rollouts: Rollouts) -> None:
    success = np.array([task.success(m) for m in rollouts.expert[-SUCCESS_STEPS:]])
    assert success.all()


def test_milestones_come_in_order(task: Task, rollouts: Rollouts) -> None:
    each = [task.milestones(m) for m in rollouts.expert]
    flags = np.array([[now[name] for name in task.milestone_names] for now in each])
    assert flags.any(axis=0).all()
    first = flags.argmax(axis=0)
    assert (np.diff(first, axis=0) >= 0).all()


def test_random_actions_do_not_solve_it(task: Task, rollouts: Rollouts) -> None:
    assert np.mean([task.success(m) for m in rollouts.random]) < 0.1


# Names


def test_a_tasks_name_is_the_one_it_is_loaded_by() -> None:
    assert {"Door", "Lift", "Reach"} <= set(task_names())
    for name in task_names():
        assert load_task(name).name == name
