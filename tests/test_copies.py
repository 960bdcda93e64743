"""Copies of batches of environments: environments of their own, or refused."""

import copy
import pickle

import numpy as np
import pytest

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.make_batch import make_batch
from manip.envs.task import Task
from manip.envs.task_batch import TaskBatch
from manip.errors import UserError
from manip.sim.scene import Scene

REFUSED = "can be neither copied nor pickled: build another one"


def begun(batch: TaskBatch) -> TaskBatch:
    batch.begin(np.arange(batch.num_envs))
    return batch


def rollout(batch: TaskBatch, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = batch.num_envs, batch.action_dim
    steps = [batch.step(rng.uniform(-1, 1, shape)).observation for _ in range(4)]
    return np.stack(steps)


def test_a_deep_copy_of_a_native_batch_goes_on_alone(
    lift: Task, lift_scene: Scene
) -> None:
    batch = begun(
        NativeBatch(lift, 3, scene=lift_scene, threads=2, restart_fraction=0.5)
    )
    rollout(batch, 0)
    twin, before = copy.deepcopy(batch), batch.observe().observation.copy()
    theirs = rollout(twin, 1)
    np.testing.assert_array_equal(batch.observe().observation, before)
    np.testing.assert_array_equal(rollout(batch, 1), theirs)
    for each in (batch, twin):
        each.begin(np.arange(3))
    np.testing.assert_array_equal(
        batch.observe().observation, twin.observe().observation
    )


@pytest.mark.parametrize("method", [copy.copy, pickle.dumps])
def test_other_copies_of_a_native_batch_are_refused(
    method, lift: Task, lift_scene: Scene
) -> None:
    with pytest.raises(UserError, match=REFUSED):
        method(NativeBatch(lift, 1, scene=lift_scene))


@pytest.mark.parametrize("method", [copy.copy, copy.deepcopy, pickle.dumps])
def test_copies_of_a_stock_batch_are_refused(
    method, lift: Task, lift_scene: Scene
) -> None:
    batch = StockBatch(lift, stock=lift_scene.stock)
    with pytest.raises(UserError, match=f"StockBatch {REFUSED}"):
        method(batch)


@pytest.mark.parametrize("method", [copy.copy, copy.deepcopy, pickle.dumps])
def test_copies_of_an_external_batch_are_refused(method) -> None:
    batch = make_batch("robosuite/Lift", 1)
    with pytest.raises(UserError, match=f"ExternalBatch {REFUSED}"):
        method(batch)
