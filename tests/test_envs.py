"""Environments: TorchRL's contract, ends of episodes, seeds, and the task registry."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from scripted import TASKS
from tensordict import TensorDict, TensorDictBase
from tiny import Tiny
from torch import Tensor
from torchrl.envs.utils import check_env_specs
from twin import copy_start

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.task import Task
from manip.envs.task_registry import load_task, task_names
from manip.errors import UserError
from manip.rewards.compose import weighted_sum
from manip.sim.robosuite_factory import make_stock
from manip.sim.scene import Scene
from manip.sim.stock_reader import stock_reader

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


def actions(steps: int, num_envs: int, seed: int = 0) -> Tensor:
    """[steps, N, 7] that do not depend on N in the worlds they share."""
    worlds = [np.random.default_rng([seed, world]) for world in range(num_envs)]
    drawn = [rng.uniform(-1, 1, (steps, 7)).astype(np.float32) for rng in worlds]
    return torch.from_numpy(np.stack(drawn, axis=1))


def run(env, moves: Tensor) -> list[TensorDictBase]:
    """Reset, then steps [T] of `step_and_maybe_reset`, with `after`: what it acts on.

    Entries: those before the step, `next` after it, `after` once resets are done.
    """
    state, steps = env.reset(), []
    for move in moves:
        state["action"] = move[:, : env.action_spec.shape[-1]]
        step, state = env.step_and_maybe_reset(state)
        steps.append(step.clone().set("after", state.clone()))
    return steps


def stacked(steps: list[TensorDictBase], *key: str) -> Tensor:
    """[T, N, ...]."""
    return torch.stack([step[key] for step in steps])


def native(task: Task, scene: Scene, num_envs: int = 4, **options) -> TaskEnv:
    return TaskEnv(
        NativeBatch(task, num_envs, scene=scene, **({"threads": 1} | options))
    )


# TorchRL's contract


def test_specs_hold_natively(task: Task, scene: Scene) -> None:
    check_env_specs(native(task, scene, 3))


def test_specs_hold_in_stock(task: Task, scene: Scene) -> None:
    check_env_specs(TaskEnv(StockBatch(task, stock=scene.stock)))


@pytest.mark.parametrize("where", ["native", "stock"])
def test_keys_and_shapes_are_as_stated(where: str, task: Task, scene: Scene) -> None:
    env = (
        native(task, scene)
        if where == "native"
        else TaskEnv(StockBatch(task, stock=scene.stock))
    )
    n = env.batch.num_envs
    width = max(part.stop for part in env.batch.layout.values())
    after = env.rollout(2)[:, -1]["next"]
    flag = (n, 1), torch.bool
    assert {name: (tuple(v.shape), v.dtype) for name, v in after.items()} == {
        "observation": ((n, width), torch.float32),
        "reward": ((n, 1), torch.float32),
        "reward_terms": ((n, len(env.batch.reward_names)), torch.float32),
        "success": flag, "terminated": flag, "truncated": flag, "done": flag,
        "milestones": ((n, len(task.milestone_names)), torch.bool),
    }  # fmt: skip


def test_the_layout_covers_the_observation(task: Task, scene: Scene) -> None:
    env = native(task, scene)
    observation = env.reset()["observation"].numpy()
    parts = task.observe(task.measure(env.batch.engine.read()))
    layout = env.batch.layout
    ends = [0, *(part.stop for part in layout.values())]
    assert [part.start for part in layout.values()] == ends[:-1]
    assert ends[-1] == observation.shape[1]
    assert layout.keys() == parts.keys()
    for name, part in layout.items():
        np.testing.assert_array_equal(
            observation[:, part], parts[name].astype(np.float32)
        )


@pytest.mark.parametrize("reward", ["shaped", "stock"])
def test_the_reward_is_the_weighted_sum_of_its_terms(
    reward: str, task: Task, scene: Scene
) -> None:
    env = native(task, scene, reward=reward)
    after = env.rollout(5)["next"]
    weights = task.weights[reward]
    assert env.batch.reward_names == tuple(weights)
    terms = dict(zip(weights, after["reward_terms"].unbind(-1), strict=True))
    torch.testing.assert_close(weighted_sum(terms, weights), after["reward"][..., 0])


def test_unknown_reward_lists_the_rewards(lift: Task, lift_scene: Scene) -> None:
    text = "unknown reward 'sparse': .*known rewards: shaped, stock"
    with pytest.raises(UserError, match=text):
        native(lift, lift_scene, reward="sparse")


# Stock and native are one process

SAME = ("observation", "reward", "reward_terms")
EQUAL = ("milestones", "success", "terminated", "truncated", "done")


@pytest.mark.parametrize("reward", ["shaped", "stock"])
def test_native_says_what_stock_says(reward: str, task: Task, scene: Scene) -> None:
    theirs = TaskEnv(StockBatch(task, stock=scene.stock, reward=reward, seed=11))
    ours = native(task, scene, 2, reward=reward)
    begin_the_same(ours, theirs)
    for move in actions(10, 1):
        step_the_same(ours, theirs, move[:, : ours.batch.action_dim])


@pytest.mark.parametrize("name", ["Door", "Lift", "Reach"])
def test_native_says_what_stock_says_until_success(name: str, scene_of) -> None:
    """Whatever the task: test_parity.py follows all of them, as they are measured."""
    task = load_task(name)
    theirs = TaskEnv(StockBatch(task, stock=scene_of(task).stock, seed=11))
    ours = native(task, scene_of(task), 2)
    begin_the_same(ours, theirs)
    for _ in range(task.horizon):
        read = {k: v[:1] for k, v in ours.batch.engine.read().items()}
        move = task.expert(task.measure(read)).astype(np.float32)
        if step_the_same(ours, theirs, torch.from_numpy(move))["success"].all():
            return
    pytest.fail("the script did not succeed")


def begin_the_same(ours: TaskEnv, theirs: TaskEnv) -> None:
    ours.reset()
    state = theirs.reset()
    copy_start(ours.batch.task, ours.batch.engine, range(2))
    assert_say_the_same(ours.observe(), state, ("observation", "reward_terms"))


def step_the_same(ours: TaskEnv, theirs: TaskEnv, move: Tensor) -> TensorDictBase:
    """Do an action [1, A] in stock and in both worlds; what came of it in stock."""
    after = theirs.step(TensorDict(action=move, batch_size=[1]))["next"]
    both = ours.step(TensorDict(action=move.expand(2, -1), batch_size=[2]))
    assert_say_the_same(both["next"], after, SAME)
    return after


def assert_say_the_same(ours, theirs, close: tuple[str, ...]) -> None:
    for world in range(2):
        for name in close:
            torch.testing.assert_close(
                ours[name][world], theirs[name][0], rtol=1e-5, atol=3e-5, msg=name
            )
        for name in EQUAL:
            assert torch.equal(ours[name][world], theirs[name][0]), name


# Ends of episodes


def test_a_time_limit_is_truncated(task: Task, scene: Scene) -> None:
    steps = run(native(task, scene, 3, horizon=4), actions(9, 3))
    ends = [step % 4 == 3 for step in range(9)]
    for name in "truncated", "done":
        found = stacked(steps, "next", name)[:, :, 0]
        assert found.tolist() == [[end] * 3 for end in ends]
    assert not stacked(steps, "next", "terminated").any()
    for name in EQUAL[2:]:
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
    moves = actions(6, 3)
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


def test_only_ended_worlds_start_again(tiny_scene: Scene) -> None:
    env = native(Tiny(), tiny_scene, 3)
    moves = torch.zeros(4, 3, 7)
    moves[:, 1, -1] = -1
    run(env, moves)
    assert env.batch.episode.tolist() == [0, 1, 0]
    assert env.batch.elapsed.tolist() == [4, 1, 4]


def test_resetting_no_world_changes_nothing(lift: Task, lift_scene: Scene) -> None:
    env = native(lift, lift_scene, 2)
    run(env, actions(2, 2))
    before = env.batch.engine.save()
    nobody = torch.zeros(2, 1, dtype=torch.bool)
    env.reset(TensorDict({"_reset": nobody}, [2]))
    np.testing.assert_array_equal(env.batch.engine.states, before.states)
    np.testing.assert_array_equal(env.batch.engine.save().readings, before.readings)
    assert env.batch.elapsed.tolist() == [2, 2]


# Staggered starts


def lengths(done: Tensor) -> list[list[int]]:
    """Lengths of each world's finished episodes, from [T, N]."""
    ends = [torch.nonzero(world).flatten().tolist() for world in done.T]
    return [np.diff([-1, *at]).tolist() for at in ends]


def test_staggered_worlds_end_at_different_times(tiny_scene: Scene) -> None:
    env = native(Tiny(), tiny_scene, 16, stagger=True)
    done = stacked(run(env, torch.zeros(20, 16, 7)), "next", "done")[..., 0]
    first, *_ = zip(*(found[:1] for found in lengths(done)), strict=True)
    later = {length for found in lengths(done) for length in found[1:]}
    assert len(set(first)) > 4
    assert set(first) <= set(range(1, 9))
    assert later == {8}


def test_staggering_moves_only_the_clock(task: Task, scene: Scene) -> None:
    plain, late = (native(task, scene, stagger=on) for on in (False, True))
    assert torch.equal(plain.reset()["observation"], late.reset()["observation"])
    assert (plain.batch.elapsed == 0).all()
    assert (late.batch.elapsed > 0).any()


def test_unstaggered_worlds_end_together(tiny_scene: Scene) -> None:
    done = stacked(
        run(native(Tiny(), tiny_scene, 4), torch.zeros(9, 4, 7)), "next", "done"
    )
    assert lengths(done[..., 0]) == [[8]] * 4


# Seeds


def observed(env, moves: Tensor) -> Tensor:
    return stacked(run(env, moves), "after", "observation")


def test_episodes_do_not_depend_on_worlds_and_threads(task: Task, scene: Scene) -> None:
    few = observed(native(task, scene, 4, horizon=3), actions(7, 4))
    many = observed(native(task, scene, 8, horizon=3, threads=2), actions(7, 8))
    assert torch.equal(few, many[:, :4])


def test_every_episode_is_another(task: Task, scene: Scene) -> None:
    env = native(task, scene, 4, seed=5)
    starts = [env.reset()["observation"] for _ in range(3)]
    starts.append(native(task, scene, 4, seed=6).reset()["observation"])
    rows = torch.cat(starts)
    gaps = torch.cdist(rows, rows) + 9 * torch.eye(len(rows))
    assert gaps.min() > 0.01


def test_a_seed_replays_its_episodes(task: Task, scene: Scene) -> None:
    env, moves = native(task, scene, 3, horizon=3), actions(5, 3)
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
    first = observed(env, actions(4, 1))
    later = env.reset()["observation"]
    env.set_seed(7)
    assert torch.equal(observed(env, actions(4, 1)), first)
    assert not torch.isclose(later, first).all(-1).any()
    env.set_seed(8)
    second_of_7 = first[1]
    assert torch.equal(env.reset()["observation"], second_of_7)


def test_restart_begins_the_first_episode_again(task: Task, scene: Scene) -> None:
    env = native(task, scene, 2)
    first = env.reset()["observation"]
    assert not torch.isclose(env.reset()["observation"], first).all()
    env.batch.restart()
    assert torch.equal(env.reset()["observation"], first)


def test_a_saved_environment_goes_on_where_it_was(task: Task, scene: Scene) -> None:
    env, moves = native(task, scene, 3, horizon=4, seed=3), actions(9, 3)
    first = observed(env, moves[:6])
    saved = env.batch.save_state()
    rest = observed_from(env, moves[6:])
    other = native(task, scene, 3, horizon=4, seed=3)
    other.reset()
    other.batch.load_state(saved)
    assert torch.equal(other.observe()["observation"], first[-1])
    assert torch.equal(observed_from(other, moves[6:]), rest)


def observed_from(env: TaskEnv, moves: Tensor) -> Tensor:
    state, found = env.observe(), []
    for move in moves:
        state["action"] = move[:, : env.action_spec.shape[-1]]
        _, state = env.step_and_maybe_reset(state)
        found.append(state["observation"].clone())
    return torch.stack(found)


# TaskBatch that break


@pytest.mark.parametrize("part", [2, -1])
def test_a_broken_world_is_cut_off_and_starts_again(
    part: int, task: Task, scene: Scene
) -> None:
    ill, well = (native(task, scene, 3) for _ in range(2))
    moves = actions(4, 3)[..., : scene.layout.action_dim]
    healthy = run(well, moves)
    moves = moves.clone()
    moves[2, 1, part] = torch.nan
    steps = run(ill, moves)
    for name in "truncated", "done":
        found = stacked(steps, "next", name)[..., 0]
        assert found.nonzero().tolist() == [[2, 1]], name
    assert not stacked(steps, "next", "terminated").any()
    for key in "observation", "reward":
        found = stacked(steps, "next", key)
        assert torch.isfinite(found).all()
        expected = stacked(healthy, "next", key)
        assert torch.equal(found[:, [0, 2]], expected[:, [0, 2]])
    assert torch.equal(steps[2]["next", "observation"][1], steps[2]["observation"][1])
    assert ill.batch.episode.tolist() == [0, 1, 0]
    assert ill.batch.elapsed.tolist() == [4, 1, 4]
    assert ill.batch.engine.broken_count == 1


def test_a_nan_action_is_cut_off_in_stock(lift: Task, lift_scene: Scene) -> None:
    moves = actions(3, 1)
    moves[1, 0, 0] = torch.nan
    steps = run(TaskEnv(StockBatch(lift, stock=lift_scene.stock)), moves)
    assert stacked(steps, "next", "truncated").flatten().tolist() == [0, 1, 0]
    assert torch.isfinite(stacked(steps, "next", "observation")).all()


# Stock environments that are rebuilt


def test_a_hard_reset_is_read_from_its_new_simulation(lift: Task) -> None:
    stock = make_stock("Lift", seed=0, hard_reset=True)
    env, sizes = TaskEnv(StockBatch(lift, stock=stock)), set()
    for _ in range(2):
        observation = env.reset()["observation"][0]
        expected = stock_reader(stock, lift.sensors)()["cube_pos"][0]
        shown = observation[env.batch.layout["cube_pos"]].numpy()
        np.testing.assert_allclose(shown / 4 + [0, 0, 0.8], expected, atol=1e-6)
        sizes.add(float(stock.sim.model._model.geom("cube_g0").size[2]))
    assert len(sizes) == 2


# The registry


def test_tasks_are_listed_and_loaded() -> None:
    assert {"Lift", "Reach"} <= set(task_names())
    assert isinstance(load_task("Lift"), Task)


def test_an_unknown_task_lists_the_tasks() -> None:
    text = "unknown task 'Lfit': did you mean 'Lift'.*known tasks: .*Lift.*Reach"
    with pytest.raises(UserError, match=text):
        load_task("Lfit")


def test_a_task_of_ones_own_is_found_by_its_path() -> None:
    assert isinstance(load_task("tiny:Tiny"), Tiny)


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("no_such_package.module:Lift", "cannot import task .*no_such_package"),
        ("manip.tasks.lift:Lfit", "cannot import task 'tasks.lift:Lfit': .*'Lfit'"),
        (":Lift", "cannot import task ':Lift'"),
        (
            "pathlib:Path",
            "task 'pathlib:Path' must be a subclass of .*Task, not .*Path",
        ),
        (
            "manip.envs.task_registry:GROUP",
            "must be a subclass of .*Task, not 'manip.tasks'",
        ),
    ],
)
def test_a_wrong_path_says_what_is_wrong(path: str, text: str) -> None:
    with pytest.raises(UserError, match=text):
        load_task(path)
