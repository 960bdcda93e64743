"""Episodes: how they end, staggered starts, and simulations that diverge."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from rollouts import actions, native, run, stacked
from scripted import TASKS
from tensordict import TensorDict
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


# Ends of episodes


def test_a_time_limit_is_truncated(task: Task, scene: Scene) -> None:
    steps = run(native(task, scene, 3, horizon=4), actions(9, 3, scene=scene))
    ends = [step % 4 == 3 for step in range(9)]
    for name in "truncated", "done":
        flags = stacked(steps, "next", name)[:, :, 0]
        assert flags.tolist() == [[end] * 3 for end in ends]
    assert not stacked(steps, "next", "terminated").any()
    for name in ("terminated", "truncated", "done"):
        assert not stacked(steps, "after", name).any()


def test_a_time_limit_is_truncated_in_stock(lift: Task, lift_scene: Scene) -> None:
    steps = run(
        TaskEnv(StockBatch(lift, stock=lift_scene.stock, horizon=3)), actions(7, 1)
    )
    truncated = stacked(steps, "next", "truncated").flatten().tolist()
    assert truncated == [False, False, True, False, False, True, False]
    assert not stacked(steps, "next", "terminated").any()


def test_the_default_horizon_is_the_tasks(lift: Task, lift_scene: Scene) -> None:
    assert native(lift, lift_scene).batch.horizon == lift.horizon


def test_a_failure_is_terminated(tiny_scene: Scene) -> None:
    env = native(Tiny(), tiny_scene, 2)
    moves = torch.zeros(7, 2, 7)
    moves[:, 0, -1], moves[:, 1, -1] = -1, 1
    steps = run(env, moves)
    terminated = stacked(steps, "next", "terminated")[:, :, 0]
    assert terminated[:, 0].tolist() == [False, False, True, False, False, True, False]
    assert not terminated[:, 1].any()
    assert not stacked(steps, "next", "truncated").any()
    assert torch.equal(
        stacked(steps, "next", "done"), stacked(steps, "next", "terminated")
    )
    assert steps[-1]["next", "success"].flatten().tolist() == [False, True]


def test_a_failure_at_the_time_limit_is_not_truncated(tiny_scene: Scene) -> None:
    moves = torch.zeros(3, 1, 7)
    moves[..., -1] = -1
    last = run(native(Tiny(), tiny_scene, 1, horizon=3), moves)[-1]["next"]
    assert last["terminated"]
    assert not last["truncated"]


def test_success_ends_nothing(tiny_scene: Scene) -> None:
    moves = torch.zeros(8, 1, 7)
    moves[..., -1] = 1
    steps = run(native(Tiny(), tiny_scene, 1), moves)
    assert (
        stacked(steps, "next", "success").flatten().tolist() == [False] * 4 + [True] * 4
    )
    assert stacked(steps, "next", "done").flatten().tolist() == [False] * 7 + [True]


def test_the_last_observation_stored_is_the_true_one(task: Task, scene: Scene) -> None:
    moves = actions(6, 3, scene=scene)
    short = run(native(task, scene, 3, horizon=6), moves)
    long = run(native(task, scene, 3, horizon=99), moves)
    for name in "observation", "reward", "success", "milestones", "reward_terms":
        ours, theirs = stacked(short, "next", name), stacked(long, "next", name)
        assert torch.equal(ours, theirs), name
    restarted = short[-1]["after", "observation"]
    assert (restarted - short[-1]["next", "observation"]).abs().amax(-1).min() > 0.1


def test_what_follows_a_step_is_what_the_next_acts_on(
    lift: Task, lift_scene: Scene
) -> None:
    steps = run(native(lift, lift_scene, 3, horizon=4), actions(6, 3))
    for before, after in pairwise(steps):
        assert torch.equal(before["after", "observation"], after["observation"])


def test_only_ended_environments_restart(tiny_scene: Scene) -> None:
    env = native(Tiny(), tiny_scene, 3)
    moves = torch.zeros(4, 3, 7)
    moves[:, 1, -1] = -1
    run(env, moves)
    assert env.batch.episode.tolist() == [0, 1, 0]
    assert env.batch.elapsed.tolist() == [4, 1, 4]


def test_resetting_no_environment_changes_nothing(
    lift: Task, lift_scene: Scene
) -> None:
    env = native(lift, lift_scene, 2)
    run(env, actions(2, 2))
    before = env.batch.engine.save()
    none = torch.zeros(2, 1, dtype=torch.bool)
    env.reset(TensorDict({"_reset": none}, [2]))
    np.testing.assert_array_equal(env.batch.engine.states, before.states)
    np.testing.assert_array_equal(env.batch.engine.save().readings, before.readings)
    assert env.batch.elapsed.tolist() == [2, 2]


# Staggered starts


def lengths(done: Tensor) -> list[list[int]]:
    """Lengths of the finished episodes of each environment, from [T, N]."""
    ends = [torch.nonzero(column).flatten().tolist() for column in done.T]
    return [np.diff([-1, *at]).tolist() for at in ends]


def test_staggered_environments_end_at_different_times(tiny_scene: Scene) -> None:
    env = native(Tiny(), tiny_scene, 16, stagger=True)
    done = stacked(run(env, torch.zeros(20, 16, 7)), "next", "done")[..., 0]
    first, *_ = zip(*(each[:1] for each in lengths(done)), strict=True)
    later = {length for each in lengths(done) for length in each[1:]}
    assert len(set(first)) > 4
    assert set(first) <= set(range(1, 9))
    assert later == {8}


def test_staggering_moves_only_the_clock(task: Task, scene: Scene) -> None:
    plain, late = (native(task, scene, stagger=on) for on in (False, True))
    assert torch.equal(plain.reset()["observation"], late.reset()["observation"])
    assert (plain.batch.elapsed == 0).all()
    assert (late.batch.elapsed > 0).any()


def test_unstaggered_environments_end_together(tiny_scene: Scene) -> None:
    done = stacked(
        run(native(Tiny(), tiny_scene, 4), torch.zeros(9, 4, 7)), "next", "done"
    )
    assert lengths(done[..., 0]) == [[8]] * 4


# Simulations that diverge


@pytest.mark.parametrize("part", [2, -1])
def test_a_diverged_environment_is_cut_off_and_restarts(
    part: int, task: Task, scene: Scene
) -> None:
    faulty, healthy = (native(task, scene, 3) for _ in range(2))
    moves = actions(4, 3, scene=scene)[..., : scene.layout.action_dim]
    expected_steps = run(healthy, moves)
    moves = moves.clone()
    moves[2, 1, part] = torch.nan
    steps = run(faulty, moves)
    for name in "truncated", "done":
        flags = stacked(steps, "next", name)[..., 0]
        assert flags.nonzero().tolist() == [[2, 1]], name
    assert not stacked(steps, "next", "terminated").any()
    for key in "observation", "reward":
        values = stacked(steps, "next", key)
        assert torch.isfinite(values).all()
        expected = stacked(expected_steps, "next", key)
        assert torch.equal(values[:, [0, 2]], expected[:, [0, 2]])
    assert torch.equal(steps[2]["next", "observation"][1], steps[2]["observation"][1])
    assert faulty.batch.episode.tolist() == [0, 1, 0]
    assert faulty.batch.elapsed.tolist() == [4, 1, 4]
    assert faulty.batch.engine.broken_count == 1


def test_a_nan_action_is_cut_off_in_stock(lift: Task, lift_scene: Scene) -> None:
    moves = actions(3, 1)
    moves[1, 0, 0] = torch.nan
    steps = run(TaskEnv(StockBatch(lift, stock=lift_scene.stock)), moves)
    assert stacked(steps, "next", "truncated").flatten().tolist() == [0, 1, 0]
    assert torch.isfinite(stacked(steps, "next", "observation")).all()
