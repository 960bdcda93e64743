"""Visible measures: named numbers, the same natively and in stock robosuite."""

import numpy as np
import pytest
import torch
from rollouts import actions, run, stacked
from scripted import TASKS
from tiny import Tiny
from twin import copy_start

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.external_batch import ExternalBatch
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.external_task import load_external
from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.errors import UserError
from manip.sim.external.dm_control_sim import ROBOT
from manip.sim.scene import Scene

CONTROL_DT = 0.05


@pytest.fixture(scope="module", params=TASKS)
def task(request) -> Task:
    return load_task(request.param)


@pytest.fixture(scope="module")
def scene(task: Task, scene_of) -> Scene:
    return scene_of(task)


@pytest.fixture(scope="module")
def lift_scene(lift: Task, scene_of) -> Scene:
    return scene_of(lift)


def test_native_measures_are_those_of_stock(task: Task, scene: Scene) -> None:
    stock = StockBatch(task, stock=scene.stock)
    batch = NativeBatch(task, 2, scene=scene, threads=1)
    stock.begin(np.arange(1))
    batch.begin(np.arange(2))
    copy_start(task, batch.engine, range(2))
    batch._visible.begin(np.arange(2))
    assert stock.measure_names == batch.measure_names
    for _ in range(12):
        action = stock.expert().astype(np.float32)
        batch.step(action.repeat(2, 0))
        stock.step(action)
        expected = stock.measures().repeat(2, 0)
        np.testing.assert_allclose(batch.measures(), expected, 1e-3, 2e-3)
    assert expected[0, batch.measure_names.index("hand_speed")] > 0.01


def test_the_motion_is_that_of_the_hand(lift: Task, lift_scene: Scene) -> None:
    batch = NativeBatch(lift, 3, scene=lift_scene, threads=1)
    batch.begin(np.arange(3))
    places, shown = [batch.read()["eef_pos"].copy()], [batch.measures()]
    for action in actions(6, 3).numpy():
        batch.step(action)
        places.append(batch.read()["eef_pos"].copy())
        shown.append(batch.measures())
    velocity = np.diff(places, axis=0) / CONTROL_DT
    change = np.diff(velocity, axis=0, prepend=np.zeros((1, 3, 3))) / CONTROL_DT
    columns = [
        batch.measure_names.index(f"hand_{n}") for n in ("speed", "acceleration")
    ]
    expected = np.stack([velocity, change], axis=-2)
    np.testing.assert_allclose(
        np.array(shown)[1:, :, columns], np.linalg.norm(expected, axis=-1), 1e-5
    )
    assert (np.array(shown)[0][:, columns] == 0).all()


def test_the_hand_is_at_rest_when_an_episode_begins(
    lift: Task, lift_scene: Scene
) -> None:
    batch = NativeBatch(lift, 2, scene=lift_scene, threads=1, horizon=4)
    env = TaskEnv(batch, measures=True)
    steps = run(env, actions(9, 2))
    speed = stacked(steps, "measures")[..., env.batch.measure_names.index("hand_speed")]
    moving = (speed > 0).all(1)
    assert moving.tolist() == [False, True, True, True] * 2 + [False]
    last = stacked(steps, "next", "measures")
    assert torch.equal(last[0], stacked(steps, "measures")[1])


def test_recorded_states_are_those_that_the_steps_left(
    lift: Task, lift_scene: Scene
) -> None:
    batch = NativeBatch(lift, 2, scene=lift_scene, threads=1, horizon=4)
    steps = run(TaskEnv(batch, measures=True, states=True), actions(6, 2))
    assert stacked(steps, "elapsed")[:, 0].tolist() == [0, 1, 2, 3, 0, 1]
    assert stacked(steps, "episode")[:, 1].tolist() == [0] * 4 + [1] * 2
    other = NativeBatch(lift, 2, scene=lift_scene, threads=1)
    state = {name: steps[2][name].numpy() for name in batch.record()}
    other.load_state(state | {"fault_count": 0})
    assert np.array_equal(other.measures(), steps[2]["measures"])
    other.step(steps[2]["action"].numpy())
    assert np.array_equal(other.measures(), steps[2]["next", "measures"])


def test_a_restored_batch_shows_the_same_measures(
    lift: Task, lift_scene: Scene
) -> None:
    batch = NativeBatch(lift, 2, scene=lift_scene, threads=1)
    other = NativeBatch(lift, 2, scene=lift_scene, threads=1)
    batch.begin(np.arange(2))
    moves = actions(8, 2).numpy()
    for action in moves[:5]:
        batch.step(action)
    other.load_state(batch.save_state())
    assert np.array_equal(other.measures(), batch.measures())
    for action in moves[5:]:
        batch.step(action)
        other.step(action)
        assert np.array_equal(other.measures(), batch.measures())


def test_a_state_without_motion_begins_at_rest(lift: Task, lift_scene: Scene) -> None:
    batch = NativeBatch(lift, 1, scene=lift_scene, threads=1)
    batch.begin(np.arange(1))
    for action in actions(3, 1).numpy():
        batch.step(action)
    state = batch.save_state()
    del state["motion"]
    batch.load_state(state)
    speed = batch.measure_names.index("hand_speed")
    assert batch.measures()[0, speed] == 0
    batch.step(actions(1, 1).numpy()[0])
    assert batch.measures()[0, speed] == 0
    batch.step(actions(1, 1).numpy()[0])
    assert 0 < batch.measures()[0, speed] < 1


class Wrong(Tiny):
    """A measure with a column for each environment, not a number."""

    def visible_measures(self, m):
        return {"closing": m["gripper_command"]}


class Spaced(Tiny):
    """A name that is not a plain one."""

    def visible_measures(self, m):
        return {"how far": m["gripper_closing"]}


@pytest.mark.parametrize(
    ("task", "message"),
    [(Wrong(), r"'closing' has shape \(2, 2\)"), (Spaced(), "'how far' must consist")],
)
def test_a_wrong_measure_is_named(task: Task, message: str, scene_of) -> None:
    with pytest.raises(UserError, match=message):
        NativeBatch(task, 2, scene=scene_of(task))


def test_a_number_that_is_not_finite_counts_as_zero(scene_of) -> None:
    class Infinite(Tiny):
        def visible_measures(self, m):
            return {"far": m["gripper_closing"] + np.inf}

    batch = NativeBatch(Infinite(), 2, scene=scene_of(Tiny()))
    assert (batch.measures() == 0).all()


def test_other_libraries_show_the_hand() -> None:
    task = load_external("dm_control/reach_site_features")
    batch = ExternalBatch(task, 1, robot=ROBOT, threads=1)
    assert batch.measure_names == ("hand_speed", "hand_acceleration")
    batch.begin(np.arange(1))
    batch.step(np.full((1, batch.action_dim), 0.5, np.float32))
    assert (batch.measures() > 0).all()
