"""The batch engine: independent environments, replayed bit for bit."""

import numpy as np
import pytest
from engines import close_in, random_actions, run, start, started

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Task
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Scene

Array = np.ndarray


def assert_same(a: BatchEngine, b: BatchEngine, env_ids=slice(None)) -> None:
    ours, theirs = a.save(env_ids), b.save(env_ids)
    np.testing.assert_array_equal(ours.states, theirs.states)
    np.testing.assert_array_equal(ours.readings, theirs.readings)


# Batches and threads


def test_a_batch_is_its_environments_one_by_one(lift: Task, lift_scene: Scene) -> None:
    batch = started(lift, lift_scene, 3, threads=2)
    single = BatchEngine(lift_scene, 1)
    close_in(lift, batch, 8)
    begin, actions = batch.save(), random_actions(10, 3)
    run(batch, actions)
    for env_id in range(3):
        single.restore(batch_row(begin, env_id))
        run(single, actions[:, env_id : env_id + 1])
        np.testing.assert_array_equal(single.states[0], batch.states[env_id])
        np.testing.assert_array_equal(
            single.save().readings[0], batch.save().readings[env_id]
        )


def batch_row(snapshot, env_id: int):
    one = slice(env_id, env_id + 1)
    return type(snapshot)(snapshot.states[one], snapshot.readings[one])


@pytest.mark.parametrize("threads", [2, 3])
def test_the_number_of_threads_changes_no_bit(
    threads: int, lift: Task, lift_scene: Scene
) -> None:
    one, many = (started(lift, lift_scene, 20, n) for n in (1, threads))
    actions = random_actions(4, 20)
    run(one, actions)
    run(many, actions)
    assert many.threads == threads
    assert_same(one, many)


def test_no_more_threads_than_environments(lift_scene: Scene) -> None:
    assert BatchEngine(lift_scene, 2, threads=7).threads == 2


# Save and restore


def test_a_restored_environment_replays_bit_for_bit(
    lift: Task, lift_scene: Scene
) -> None:
    engine = started(lift, lift_scene, 2)
    close_in(lift, engine, 16)
    saved, actions = engine.save(), random_actions(5, 2)
    run(engine, actions)
    first = engine.save()
    engine.restore(saved)
    np.testing.assert_array_equal(engine.save().readings, saved.readings)
    run(engine, actions)
    np.testing.assert_array_equal(engine.states, first.states)
    np.testing.assert_array_equal(engine.save().readings, first.readings)


def test_environments_move_to_other_places_and_engines(
    reach: Task, reach_scene: Scene
) -> None:
    here = started(reach, reach_scene, 3)
    there = started(reach, reach_scene, 5)
    actions = random_actions(3, 3)
    run(here, actions)
    there.restore(here.save(np.array([2, 0])), np.array([1, 4]))
    run(here, actions)
    for action in actions:
        wider = np.zeros((5, 7))
        wider[[1, 4]] = action[[2, 0]]
        there.step(wider)
    np.testing.assert_array_equal(there.states[[1, 4]], here.states[[2, 0]])


def test_hidden_controller_state_is_saved(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 1)
    begin = engine.read()["joint_pos"].copy()
    run(engine, np.full((3, 1, 7), 1.0))
    read = engine.read()
    np.testing.assert_array_equal(read["start_pos"], begin)
    np.testing.assert_allclose(read["gripper_command"], [[-0.6, 0.6]])
    engine.restore(engine.save())
    for name in "start_pos", "gripper_command":
        np.testing.assert_array_equal(engine.read()[name], read[name])


@pytest.mark.parametrize("hidden", ["start_pos", "gripper_command"])
def test_hidden_controller_state_steers(
    hidden: str, lift: Task, lift_scene: Scene
) -> None:
    """Otherwise the test above could not fail."""
    engine = started(lift, lift_scene, 2)
    engine.restore(engine.save([0, 0]))
    engine.states[1, engine.state_columns(hidden)] += 0.4
    run(engine, np.zeros((3, 2, 7)))
    one, other = engine.read()["qpos"]
    assert np.abs(one - other).max() > 1e-3


def test_a_reset_forgets_the_episode_before(lift: Task, lift_scene: Scene) -> None:
    used, fresh = (started(lift, lift_scene, 2) for _ in range(2))
    close_in(lift, used, 20)
    start(lift, used, seed=5)
    start(lift, fresh, seed=5)
    assert_same(used, fresh)
    actions = random_actions(3, 2)
    run(used, actions)
    run(fresh, actions)
    assert_same(used, fresh)


def test_a_partial_reset_leaves_the_others(lift: Task, lift_scene: Scene) -> None:
    reset, plain = (started(lift, lift_scene, 4, threads=2) for _ in range(2))
    actions = random_actions(6, 4)
    run(reset, actions[:3])
    run(plain, actions[:3])
    env_ids = np.array([1])
    streams = EpisodeStreams(9, env_ids, env_ids)
    reset.reset(env_ids, *lift.sample_start(lift_scene, streams))
    others = np.array([0, 2, 3])
    assert_same(reset, plain, others)
    run(reset, actions[3:])
    run(plain, actions[3:])
    assert_same(reset, plain, others)
    assert (reset.states[1] != plain.states[1]).any()


def test_fields_belong_to_an_environment(reach: Task, reach_scene: Scene) -> None:
    engine = started(reach, reach_scene, 3)
    before = engine.read()["goal_pos"].copy()
    qpos = engine.read()["qpos"][[1]].copy()
    engine.reset(np.array([1]), qpos, {"goal_place": np.array([[0.1, 0.2, 1.0]])})
    run(engine, np.zeros((2, 3, 7)))
    goals = engine.read()["goal_pos"]
    np.testing.assert_array_equal(goals[[0, 2]], before[[0, 2]])
    np.testing.assert_array_equal(goals[1], [0.1, 0.2, 1.0])
    np.testing.assert_array_equal(engine.read()["goal_place"], goals)


def test_a_reset_without_fields_takes_the_models(
    reach: Task, reach_scene: Scene
) -> None:
    engine, fresh = started(reach, reach_scene, 2), BatchEngine(reach_scene, 2)
    goals = fresh.read()["goal_pos"]
    assert (engine.read()["goal_pos"] != goals).any()
    engine.reset(np.arange(2), engine.read()["qpos"])
    np.testing.assert_array_equal(engine.read()["goal_pos"], goals)


def test_pictures_show_the_fields_of_their_environment(
    reach: Task, reach_scene: Scene
) -> None:
    engine = started(reach, reach_scene, 2)
    site = reach_scene.visual.site("goal").id
    before = reach_scene.visual.site_pos[site].copy()
    drawn = engine.visual_model(engine.states[1])
    np.testing.assert_array_equal(drawn.site_pos[site], engine.read()["goal_pos"][1])
    np.testing.assert_array_equal(reach_scene.visual.site_pos[site], before)
    assert drawn.ngeom == reach_scene.visual.ngeom > reach_scene.physics.ngeom


# Actions


def test_actions_are_clipped(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2)
    engine.restore(engine.save([0, 0]))
    sign = np.array([1.0, -1, 1, -1, 1, -1, 1])
    run(engine, np.stack([sign, 9 * sign])[None])
    np.testing.assert_array_equal(engine.states[0], engine.states[1])


def test_only_the_sign_of_the_grip_counts(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 3)
    engine.restore(engine.save([0, 0, 0]))
    action = np.zeros((3, 7))
    action[:, -1] = [0.01, 1.0, -1.0]
    run(engine, np.stack([action] * 3))
    small, full, opening = engine.read()["gripper_qpos"]
    np.testing.assert_array_equal(small, full)
    assert np.ptp(full) < np.ptp(opening)


def test_the_callers_action_stays_as_it_is(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2)
    action = 3 * random_actions(1, 2)[0]
    before = action.copy()
    engine.step(action)
    np.testing.assert_array_equal(action, before)


# Environments that break


def nan_arm(engine: BatchEngine, action: Array) -> None:
    action[1, 2] = np.nan


def nan_grip(engine: BatchEngine, action: Array) -> None:
    action[1, -1] = np.nan


def exploded(engine: BatchEngine, action: Array) -> None:
    engine.states[1, engine.scene.physics.nq] = 1e12


def nan_state(engine: BatchEngine, action: Array) -> None:
    engine.states[1, 3] = np.nan


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("fault", [nan_arm, nan_grip, exploded, nan_state])
def test_a_broken_environment_stays_alone(
    fault, threads: int, lift: Task, lift_scene: Scene
) -> None:
    ill, well = (started(lift, lift_scene, 4, threads) for _ in range(2))
    first, faulty, *rest = random_actions(4, 4)
    run(ill, [first])
    before = ill.save()
    healthy = faulty.copy()
    fault(ill, faulty)
    ill.step(faulty)
    np.testing.assert_array_equal(ill.broken, [False, True, False, False])
    assert ill.broken_count == 1
    np.testing.assert_array_equal(ill.save().readings[1], before.readings[1])
    start(lift, well)
    run(well, [first, healthy])
    ill.restore(batch_row(well.save(), 1), slice(1, 2))
    assert_same(ill, well)
    run(ill, rest)
    run(well, rest)
    assert_same(ill, well)
    assert (ill.broken_count, well.broken_count) == (1, 0)


@pytest.mark.parametrize("fault", [nan_arm, nan_grip])
def test_a_broken_environment_keeps_the_state_from_before(
    fault, lift: Task, lift_scene: Scene
) -> None:
    engine = started(lift, lift_scene, 2)
    run(engine, random_actions(2, 2))
    before, action = engine.save(), np.ones((2, 7))
    fault(engine, action)
    engine.step(action)
    np.testing.assert_array_equal(engine.states[1], before.states[1])
    assert (engine.states[0] != before.states[0]).any()
    assert all(np.isfinite(values).all() for values in engine.read().values())


def test_a_broken_environment_recovers_with_a_reset(
    lift: Task, lift_scene: Scene
) -> None:
    engine = started(lift, lift_scene, 2)
    exploded(engine, np.zeros(0))
    engine.step(np.zeros((2, 7)))
    start(lift, engine, seed=1)
    engine.step(np.zeros((2, 7)))
    assert not engine.broken.any()
    fresh = BatchEngine(lift_scene, 2)
    start(lift, fresh, seed=1)
    fresh.step(np.zeros((2, 7)))
    assert_same(engine, fresh)
