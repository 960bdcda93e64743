"""What an engine promises to its users: states, copies, threads and processes."""

import copy
import multiprocessing
import pickle
import threading

import numpy as np
import pytest
from engines import random_actions, run, started
from twin import copy_state, start_twin

from manip.envs.task import Task
from manip.errors import UserError
from manip.sim.batch_engine import BatchEngine
from manip.sim.engine import Engine, Snapshot
from manip.sim.scene import Scene, build_scene
from manip.sim.sensors import Sensors
from manip.sim.stock_reader import stock_reader

Array = np.ndarray


def test_the_batch_engine_is_an_engine(lift_scene: Scene) -> None:
    engine: Engine = BatchEngine(lift_scene, 1)
    assert isinstance(engine, Engine)


# Readings


def test_readings_cannot_be_written(reach: Task, reach_scene: Scene) -> None:
    engine = started(reach, reach_scene, 2)
    run(engine, random_actions(1, 2))
    for name, values in engine.read().items():
        with pytest.raises(ValueError, match="read-only"):
            values[...] = 0
        assert not values.flags.writeable, name


def test_readings_of_stock_cannot_be_written(lift: Task, lift_scene: Scene) -> None:
    for name, values in stock_reader(lift_scene.stock, lift.sensors)().items():
        assert not values.flags.writeable, name


def test_readings_are_not_copied(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2)
    once, twice = engine.read(), engine.read()
    for name in ("qpos", "cube_pos", "start_pos", "left_touch"):
        assert np.shares_memory(once[name], twice[name]), name


# States


def test_before_is_the_snapshot_before_the_last_step(
    lift: Task, lift_scene: Scene
) -> None:
    engine = started(lift, lift_scene, 3, threads=2)
    for action in random_actions(3, 3):
        snapshot = engine.save()
        action[1] = np.nan
        engine.step(action)
        np.testing.assert_array_equal(engine.before.states, snapshot.states)
        np.testing.assert_array_equal(engine.before.readings, snapshot.readings)
        assert (engine.states[0] != snapshot.states[0]).any()


def test_memory_stays_until_a_reset(lift_scene: Scene) -> None:
    sensors = Sensors(memory={"height": 2})
    engine = BatchEngine(build_scene(lift_scene.stock, sensors), 3, threads=1)
    heights = np.array([[1.0, 2.0], [3.0, 4.0]])
    engine.write_memory(np.array([2, 0]), {"height": heights})
    run(engine, random_actions(3, 3))
    expected = np.array([[3.0, 4.0], [0.0, 0.0], [1.0, 2.0]])
    np.testing.assert_array_equal(engine.read()["height"], expected)
    engine.reset(np.array([0]), lift_scene.layout.qpos[None])
    np.testing.assert_array_equal(engine.read()["height"][0], 0)
    engine.set_state(
        np.array([1]),
        engine.read()["qpos"][[1]],
        engine.read()["qvel"][[1]],
        memory={"height": heights[:1]},
    )
    np.testing.assert_array_equal(engine.read()["height"][1], heights[0])


HIDDEN = ("start_pos", "gripper_command", "goal_place")


def parts(engine: BatchEngine, env_id: int) -> tuple[Array, Array, dict]:
    read = engine.read()
    hidden = {name: read[name][[env_id]] for name in HIDDEN}
    fields = {"goal_place": hidden.pop("goal_place")}
    return read["qpos"][[env_id]], read["qvel"][[env_id]], hidden | {"fields": fields}


def test_a_state_set_goes_on_like_the_state_it_was_read_from(
    reach: Task, reach_scene: Scene
) -> None:
    source, target = started(reach, reach_scene, 2), BatchEngine(reach_scene, 3)
    run(source, random_actions(8, 2))
    qpos, qvel, hidden = parts(source, 1)
    target.set_state(np.array([2]), qpos, qvel, **hidden)
    for name in ("qpos", "qvel", *HIDDEN):
        ours, theirs = target.read()[name][2], source.read()[name][1]
        np.testing.assert_array_equal(ours, theirs)
    more = random_actions(5, 2)
    run(source, more)
    run(target, np.stack([more[:, 0], more[:, 0], more[:, 1]], axis=1))
    for name in ("qpos", "eef_pos"):
        ours, theirs = target.read()[name][2], source.read()[name][1]
        np.testing.assert_allclose(ours, theirs, atol=1e-6)


def test_a_state_set_reads_at_once_and_alone(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 3, threads=2)
    run(engine, random_actions(4, 3))
    others, before = np.array([0, 2]), engine.save()
    cube = lift_scene.free_qpos("cube_main")
    qpos, qvel = engine.read()["qpos"][[1]], np.zeros((1, lift_scene.physics.nv))
    qpos[0, cube.start + 2] += 0.2
    engine.set_state(np.array([1]), qpos, qvel)
    read = engine.read()
    np.testing.assert_array_equal(read["cube_pos"][1], qpos[0, cube][:3])
    np.testing.assert_array_equal(read["qvel"][1], 0)
    np.testing.assert_array_equal(engine.states[others], before.states[others])
    np.testing.assert_array_equal(engine.save(others).readings, before.readings[others])
    kept = engine.state_columns("gripper_command")
    np.testing.assert_array_equal(engine.states[1, kept], before.states[1, kept])


def test_a_state_set_is_stocks_state(lift: Task, lift_scene: Scene) -> None:
    stock = lift_scene.stock
    start_twin(lift, BatchEngine(lift_scene, 1), [0], seed=4)
    moves = random_actions(12, 1)[:, 0]
    for action in moves[:6]:
        stock.step(action)
    read = stock_reader(stock, lift.sensors)()
    ours, row = BatchEngine(lift_scene, 2), BatchEngine(lift_scene, 2)
    hidden = {name: read[name] for name in ("start_pos", "gripper_command")}
    ours.set_state(np.array([1]), read["qpos"], read["qvel"], **hidden)
    copy_state(lift, row, [1])
    for action in moves[6:]:
        observed, *_ = stock.step(action)
        ours.step(np.tile(action, (2, 1)))
    joints = ours.read()["joint_pos"][1]
    np.testing.assert_allclose(joints, observed["robot0_joint_pos"], atol=1e-5)


# Copies, threads, processes


def test_a_deep_copy_is_an_engine_of_its_own(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2, threads=2)
    run(engine, random_actions(3, 2))
    twin, begin = copy.deepcopy(engine), engine.save()
    run(twin, random_actions(2, 2))
    np.testing.assert_array_equal(engine.states, begin.states)
    run(engine, random_actions(2, 2))
    for name, values in engine.read().items():
        np.testing.assert_array_equal(values, twin.read()[name], err_msg=name)


@pytest.mark.parametrize("method", [copy.copy, pickle.dumps])
def test_other_copies_of_engine_and_scene_are_refused(
    method, lift_scene: Scene
) -> None:
    for original in (BatchEngine(lift_scene, 1), lift_scene):
        with pytest.raises(UserError, match="can be neither copied nor pickled"):
            method(original)


def test_snapshots_can_be_pickled(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2)
    snapshot: Snapshot = pickle.loads(pickle.dumps(engine.save()))
    np.testing.assert_array_equal(snapshot.states, engine.states)


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_an_engine_steps_in_a_forked_child(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 4, threads=2)
    run(engine, random_actions(1, 4))  # the threads run

    def child(answers) -> None:
        run(engine, random_actions(2, 4))
        answers.put(engine.states)

    context = multiprocessing.get_context("fork")
    answers = context.Queue()
    process = context.Process(target=child, args=(answers,))
    process.start()
    theirs = answers.get(timeout=60)
    process.join(60)
    assert process.exitcode == 0
    run(engine, random_actions(2, 4))
    np.testing.assert_array_equal(engine.states, theirs)


def test_a_second_thread_is_refused(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 64, threads=1)
    errors: list[Exception] = []
    begin = threading.Barrier(3)

    def use() -> None:
        begin.wait()
        try:
            run(engine, random_actions(3, 64))
        except UserError as error:
            errors.append(error)

    users = [threading.Thread(target=use) for _ in range(3)]
    for user in users:
        user.start()
    for user in users:
        user.join()
    assert errors
    assert all("in use by another thread" in str(error) for error in errors)
    run(engine, random_actions(1, 64))


def test_an_error_does_not_keep_the_engine_locked(lift_scene: Scene) -> None:
    engine = BatchEngine(lift_scene, 2)
    with pytest.raises(ValueError, match="broadcast"):
        engine.restore(Snapshot(np.zeros((2, 3)), np.zeros((2, 3))))
    engine.step(np.zeros((2, 7)))
