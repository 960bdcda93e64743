"""What an engine promises to its users: states, copies, threads and processes."""

import copy
import multiprocessing
import pickle
import threading

import numpy as np
import pytest
from twin import copy_state, start_twin

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Task
from manip.errors import UserError
from manip.sim.batch_engine import BatchEngine
from manip.sim.engine import Engine, Snapshot
from manip.sim.scene import Scene, build_scene
from manip.sim.sensors import Sensors
from manip.sim.stock_reader import stock_reader

Array = np.ndarray


def started(task: Task, scene: Scene, num_envs: int, threads: int = 1) -> BatchEngine:
    engine, env_ids = BatchEngine(scene, num_envs, threads), np.arange(num_envs)
    streams = EpisodeStreams(0, env_ids, 0 * env_ids)
    engine.reset(env_ids, *task.sample_start(scene, streams))
    return engine


def actions(steps: int, num_envs: int) -> Array:
    return np.random.default_rng(1).uniform(-1, 1, (steps, num_envs, 7))


def run(engine: BatchEngine, moves: Array) -> None:
    for action in moves:
        engine.step(action)


def test_the_batch_engine_is_an_engine(lift_scene: Scene) -> None:
    engine: Engine = BatchEngine(lift_scene, 1)
    assert isinstance(engine, Engine)


# Readings


def test_readings_cannot_be_written(reach: Task, reach_scene: Scene) -> None:
    engine = started(reach, reach_scene, 2)
    run(engine, actions(1, 2))
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
    for action in actions(3, 3):
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
    run(engine, actions(3, 3))
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
    run(source, actions(8, 2))
    qpos, qvel, hidden = parts(source, 1)
    target.set_state(np.array([2]), qpos, qvel, **hidden)
    for name in ("qpos", "qvel", *HIDDEN):
        ours, theirs = target.read()[name][2], source.read()[name][1]
        np.testing.assert_array_equal(ours, theirs)
    more = actions(5, 2)
    run(source, more)
    run(target, np.stack([more[:, 0], more[:, 0], more[:, 1]], axis=1))
    for name in ("qpos", "eef_pos"):
        ours, theirs = target.read()[name][2], source.read()[name][1]
        np.testing.assert_allclose(ours, theirs, atol=1e-6)


def test_a_state_set_reads_at_once_and_alone(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 3, threads=2)
    run(engine, actions(4, 3))
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
    moves = actions(12, 1)[:, 0]
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


NQ, NV = 16, 15


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"qpos": np.zeros((1, 3))}, r"qpos has shape \(1, 3\), expected \(1, 16\)"),
        ({"qpos": np.zeros(NQ)}, r"qpos has shape \(16,\), expected \(1, 16\)"),
        ({"qvel": np.zeros((2, NV))}, r"qvel has shape \(2, 15\), expected \(1, 15\)"),
        ({"qvel": np.full((1, NV), np.nan)}, "not finite"),
        ({"gripper_command": np.zeros((1, 7))}, r"gripper_command has shape \(1, 7\)"),
        ({"fields": {"goal": np.zeros((1, 3))}}, "unknown model field 'goal'"),
        ({"memory": {"start_pos": np.zeros((1, 7))}}, "unknown memory 'start_pos'"),
        ({"env_ids": np.array([2])}, "env_ids must be .* from 0 to 1"),
        ({"env_ids": np.array([-1])}, "env_ids must be .* from 0 to 1"),
        ({"env_ids": np.array([0.0])}, "env_ids must be .* from 0 to 1"),
        ({"env_ids": np.array([True])}, "env_ids must be .* from 0 to 1"),
        ({"env_ids": np.array([[0]])}, "env_ids must be .* from 0 to 1"),
        ({"env_ids": np.array([1, 1])}, "env_ids must be different"),
    ],
)
def test_a_state_of_another_shape_is_refused(
    change: dict, text: str, lift_scene: Scene
) -> None:
    engine = BatchEngine(lift_scene, 2)
    before = engine.save()
    state = {
        "env_ids": np.array([0]),
        "qpos": np.zeros((1, NQ)),
        "qvel": np.zeros((1, NV)),
    }
    with pytest.raises(UserError, match=text):
        engine.set_state(**(state | change))
    np.testing.assert_array_equal(engine.states, before.states)


@pytest.mark.parametrize(
    ("env_ids", "qpos", "fields", "text"),
    [
        ([0], (1, 3), {}, r"qpos has shape \(1, 3\), expected \(1, 9\)"),
        ([0, 1], (1, 9), {}, r"qpos has shape \(1, 9\), expected \(2, 9\)"),
        ([0], (1, 9), {"goal": (1, 3)}, "unknown model field 'goal'"),
        ([0], (1, 9), {"start_pos": (1, 7)}, "unknown model field 'start_pos'"),
        ([0], (1, 9), {"goal_place": (3,)}, r"goal_place has shape \(3,\)"),
        ([5], (1, 9), {}, "env_ids must be"),
    ],
)
def test_a_reset_of_another_shape_is_refused(
    env_ids: list, qpos: tuple, fields: dict, text: str, reach_scene: Scene
) -> None:
    engine = BatchEngine(reach_scene, 2)
    values = {name: np.zeros(shape) for name, shape in fields.items()}
    with pytest.raises(UserError, match=text):
        engine.reset(np.array(env_ids), np.zeros(qpos), values)


def test_memory_is_checked(lift_scene: Scene) -> None:
    with pytest.raises(UserError, match="unknown memory 'height'"):
        BatchEngine(lift_scene, 2).write_memory([0], {"height": np.zeros((1, 1))})


@pytest.mark.parametrize(
    "action",
    [
        [["a"] * 7] * 2,
        [[None] * 7] * 2,
        [[0.0] * 7, [0.0] * 6],
        np.zeros((2, 7), complex),
        "forward",
        None,
    ],
)
def test_actions_that_are_not_numbers_are_refused(action, lift_scene: Scene) -> None:
    with pytest.raises(UserError, match="must be real numbers of shape"):
        BatchEngine(lift_scene, 2).step(action)


@pytest.mark.parametrize("dtype", [bool, np.int8, np.float16, np.float32])
def test_actions_of_any_number_type_are_taken(dtype, lift_scene: Scene) -> None:
    ours, theirs = (BatchEngine(lift_scene, 2) for _ in range(2))
    ours.step(np.ones((2, 7), dtype))
    theirs.step(np.ones((2, 7)))
    np.testing.assert_array_equal(ours.states, theirs.states)


# Copies, threads, processes


def test_a_deep_copy_is_an_engine_of_its_own(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2, threads=2)
    run(engine, actions(3, 2))
    twin, begin = copy.deepcopy(engine), engine.save()
    run(twin, actions(2, 2))
    np.testing.assert_array_equal(engine.states, begin.states)
    run(engine, actions(2, 2))
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
    run(engine, actions(1, 4))  # the threads run

    def child(answers) -> None:
        run(engine, actions(2, 4))
        answers.put(engine.states)

    context = multiprocessing.get_context("fork")
    answers = context.Queue()
    process = context.Process(target=child, args=(answers,))
    process.start()
    theirs = answers.get(timeout=60)
    process.join(60)
    assert process.exitcode == 0
    run(engine, actions(2, 4))
    np.testing.assert_array_equal(engine.states, theirs)


def test_a_second_thread_is_refused(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 64, threads=1)
    errors: list[Exception] = []
    begin = threading.Barrier(3)

    def use() -> None:
        begin.wait()
        try:
            run(engine, actions(3, 64))
        except UserError as error:
            errors.append(error)

    users = [threading.Thread(target=use) for _ in range(3)]
    for user in users:
        user.start()
    for user in users:
        user.join()
    assert errors
    assert all("in use by another thread" in str(error) for error in errors)
    run(engine, actions(1, 64))


def test_an_error_does_not_keep_the_engine_locked(lift_scene: Scene) -> None:
    engine = BatchEngine(lift_scene, 2)
    with pytest.raises(ValueError, match="broadcast"):
        engine.restore(Snapshot(np.zeros((2, 3)), np.zeros((2, 3))))
    engine.step(np.zeros((2, 7)))
