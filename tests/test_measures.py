"""A step measures once; restarted rows are measured again."""

import numpy as np
import pytest
import torch
from rollouts import actions, native
from scripted import TASKS
from tiny import Tiny

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors

Array = np.ndarray


@pytest.fixture(scope="module", params=TASKS)
def task(request) -> Task:
    return load_task(request.param)


@pytest.fixture(scope="module")
def scene(task: Task, scene_of) -> Scene:
    return scene_of(task)


@pytest.fixture(scope="module")
def tiny_scene(scene_of) -> Scene:
    return scene_of(Tiny())


# A step measures once


class Counted(Tiny):
    """Record the number of rows of each call of `measure`."""

    def __init__(self) -> None:
        self.rows: list[int] = []

    def measure(self, read):
        self.rows.append(len(read["joint_pos"]))
        return super().measure(read)

    def expert(self, m):
        return np.zeros((len(m["joint_pos"]), 7))


class Remembering(Counted):
    """Store the height of the tool, which later measures depend on."""

    sensors = Sensors(memory={"height": 1})

    def measure(self, read):
        return super().measure(read) | {"fall": read["height"] - read["eef_pos"][:, 2:]}

    def update_memory(self, m):
        return {"height": m["eef_pos"][:, 2:]}


def test_a_step_measures_once_and_a_restart_its_own_rows(scene_of) -> None:
    task = Counted()
    env = native(task, scene_of(Tiny()), 5, stagger=True)
    env = TaskEnv(env.batch, expert=True)
    state = env.reset()
    for _ in range(12):
        task.rows.clear()
        state["action"] = torch.zeros(5, 7)
        step, state = env.step_and_maybe_reset(state)
        ended = int(step["next", "done"].sum())
        assert task.rows == [5, *[ended] * (ended > 0)]


def test_measures_of_a_restart_are_those_of_the_whole_batch(scene_of) -> None:
    """They are measured row by row, and from the memory as it is now."""
    task = Remembering()
    batch = native(task, scene_of(task), 4, stagger=True).batch
    batch.begin(np.arange(4))
    for move in actions(12, 4):
        done = batch.step(move.numpy()).done
        batch.begin(np.flatnonzero(done))
        cached, fresh = batch._cache.get(), task.measure(batch.read())
        assert cached.keys() == fresh.keys()
        for name, values in fresh.items():
            np.testing.assert_array_equal(cached[name], values, err_msg=name)


def test_a_state_set_by_hand_is_measured(tiny_scene: Scene) -> None:
    batch = native(Tiny(), tiny_scene, 3).batch
    batch.begin(np.arange(3))
    batch.observe()
    engine, one = batch.engine, np.array([1])
    qpos = engine.states[one, : tiny_scene.nq].copy()
    qpos[:, 0] += 0.5
    engine.set_state(one, qpos, np.zeros((1, tiny_scene.physics.nv)))
    joint = batch.observation_spec.split(batch.observe().observation)["joint_pos"]
    assert joint[1, 0] == pytest.approx(qpos[0, 0])
