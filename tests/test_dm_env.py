"""Tasks through dm_env: its own test suite, named parts, ends of episodes."""

from unittest import TestCase

import dm_env
import numpy as np
import pytest
from dm_env.test_utils import EnvironmentTestMixin

from manip.envs.adapters.dm_env import TaskEnvironment
from manip.envs.backends import native_batch as native
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task_registry import load_task
from manip.sim.scene import Scene


@pytest.fixture(autouse=True)
def _shared_scene(reach_scene: Scene, monkeypatch) -> None:
    monkeypatch.setattr(native, "load_scene", lambda *_: reach_scene)


class TestDmEnvSuite(EnvironmentTestMixin, TestCase):
    """dm_env's own tests, through the end of an episode of 8 steps."""

    def make_object_under_test(self) -> dm_env.Environment:
        return TaskEnvironment("Reach", horizon=8)


def test_observations_are_the_tasks_parts() -> None:
    env = TaskEnvironment("Reach", seed=3)
    batch = NativeBatch(load_task("Reach"), 1, seed=3)
    batch.begin(np.zeros(1, int))
    parts, expected = env.reset().observation, batch.observe().observation[0]
    assert (*parts,) == (*env.observation_spec(),) == batch.observation_spec.names
    np.testing.assert_array_equal(np.concatenate(list(parts.values())), expected)


def test_at_the_time_limit_the_discount_is_1() -> None:
    env, action = TaskEnvironment("Reach", horizon=2), np.zeros(7, np.float32)
    steps = [env.step(action) for _ in range(4)]
    assert [each.discount for each in steps] == [None, 1.0, 1.0, None]
    assert [each.last() for each in steps] == [False, False, True, False]


def test_a_failure_ends_with_discount_0() -> None:
    env, action = TaskEnvironment("tiny:Tiny"), -np.ones(7, np.float32)
    env.reset()
    steps = [env.step(action) for _ in range(3)]
    assert [each.discount for each in steps] == [1.0, 1.0, 0.0]


def test_success_is_an_attribute() -> None:
    env, action = TaskEnvironment("tiny:Tiny"), np.ones(7, np.float32)
    env.reset()
    success = []
    for _ in range(8):
        env.step(action)
        success.append(env.success)
    assert success == [False] * 4 + [True] * 4


def test_a_seed_gives_the_same_episodes_and_each_is_another() -> None:
    def starts(seed: int) -> np.ndarray:
        env = TaskEnvironment("Reach", seed=seed)
        return np.array([env.reset().observation["goal_pos"] for _ in range(3)])

    np.testing.assert_array_equal(starts(1), starts(1))
    rows = np.concatenate([starts(1), starts(2)])
    gaps = np.linalg.norm(rows[:, None] - rows, axis=2) + 9 * np.eye(6)
    assert gaps.min() > 0.01
