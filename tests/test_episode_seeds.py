"""Seeds, restarts and saved states of episodes."""

import numpy as np
import pytest
import torch
from rollouts import actions, native, run, stacked
from scripted import TASKS
from tiny import Tiny
from torch import Tensor

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.sim.scene import Scene

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


# Seeds


def observed(env, moves: Tensor) -> Tensor:
    return stacked(run(env, moves), "after", "observation")


def test_episodes_do_not_depend_on_num_envs_and_threads(
    task: Task, scene: Scene
) -> None:
    few = observed(native(task, scene, 4, horizon=3), actions(7, 4, scene=scene))
    many = observed(
        native(task, scene, 8, horizon=3, threads=2), actions(7, 8, scene=scene)
    )
    assert torch.equal(few, many[:, :4])


def test_every_episode_is_another(task: Task, scene: Scene) -> None:
    env = native(task, scene, 4, seed=5)
    starts = [env.reset()["observation"] for _ in range(3)]
    starts.append(native(task, scene, 4, seed=6).reset()["observation"])
    rows = torch.cat(starts)
    gaps = torch.cdist(rows, rows) + 9 * torch.eye(len(rows))
    assert gaps.min() > 0.01


def test_a_seed_replays_its_episodes(task: Task, scene: Scene) -> None:
    env, moves = native(task, scene, 3, horizon=3), actions(5, 3, scene=scene)
    env.set_seed(7)
    first = observed(env, moves)
    env.set_seed(8)
    other = observed(env, moves)
    env.set_seed(7)
    assert torch.equal(observed(env, moves), first)
    assert not torch.isclose(other, first).all()
    made = native(task, scene, 3, horizon=3, seed=7)
    assert torch.equal(observed(made, moves), first)


def test_a_seed_replays_in_stock(task: Task, scene: Scene) -> None:
    env = TaskEnv(StockBatch(task, stock=scene.stock, horizon=2, seed=7))
    first = observed(env, actions(4, 1, scene=scene))
    later = env.reset()["observation"]
    env.set_seed(7)
    assert torch.equal(observed(env, actions(4, 1, scene=scene)), first)
    assert not torch.isclose(later, first).all(-1).any()
    env.set_seed(8)
    assert not torch.isclose(env.reset()["observation"], first).all(-1).any()


def test_restart_begins_the_first_episode_again(task: Task, scene: Scene) -> None:
    env = native(task, scene, 2)
    first = env.reset()["observation"]
    assert not torch.isclose(env.reset()["observation"], first).all()
    env.batch.restart()
    assert torch.equal(env.reset()["observation"], first)


def test_a_saved_environment_goes_on_where_it_was(task: Task, scene: Scene) -> None:
    env, moves = native(task, scene, 3, horizon=4, seed=3), actions(9, 3, scene=scene)
    first = observed(env, moves[:6])
    saved = env.batch.save_state()
    rest = observed_from(env, moves[6:])
    other = native(task, scene, 3, horizon=4, seed=3)
    other.reset()
    other.batch.load_state(saved)
    assert torch.equal(other.observe()["observation"], first[-1])
    assert torch.equal(observed_from(other, moves[6:]), rest)


def observed_from(env: TaskEnv, moves: Tensor) -> Tensor:
    state, observations = env.observe(), []
    for move in moves:
        state["action"] = move[:, : env.action_spec.shape[-1]]
        _, state = env.step_and_maybe_reset(state)
        observations.append(state["observation"].clone())
    return torch.stack(observations)
