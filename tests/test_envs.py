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
from manip.envs.make_batch import make_batch
from manip.envs.task import Task
from manip.envs.task_batch import TaskBatch
from manip.envs.task_registry import load_task, task_names
from manip.errors import UserError
from manip.rewards.compose import weighted_sum
from manip.robot_config import RobotConfig
from manip.sim.robosuite_factory import make_stock
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
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
    """[steps, N, 7] that do not depend on N in the environments they share."""
    rngs = [np.random.default_rng([seed, env_id]) for env_id in range(num_envs)]
    drawn = [rng.uniform(-1, 1, (steps, 7)).astype(np.float32) for rng in rngs]
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
    width = env.batch.observation_spec.dim
    after = env.rollout(2)[:, -1]["next"]
    flag = (n, 1), torch.bool
    assert {name: (tuple(v.shape), v.dtype) for name, v in after.items()} == {
        "observation": ((n, width), torch.float32),
        "reward": ((n, 1), torch.float32),
        "reward_terms": ((n, len(env.batch.reward_names)), torch.float32),
        "success": flag, "terminated": flag, "truncated": flag, "done": flag,
        "milestones": ((n, len(task.milestone_names)), torch.bool),
    }  # fmt: skip


def test_the_observation_is_its_parts_joined(task: Task, scene: Scene) -> None:
    env = native(task, scene)
    state = env.reset()
    expected = task.observe(task.measure(env.batch.engine.read()))
    parts = env.parts(state)
    assert list(parts) == list(expected) == list(env.batch.observation_spec.names)
    for name, part in parts.items():
        np.testing.assert_array_equal(part, expected[name].astype(np.float32))
    joined = torch.cat(list(parts.values()), dim=-1)
    assert torch.equal(joined, state["observation"])
    roles = {part.name: part.role for part in env.batch.observation_spec.parts}
    assert roles["joint_pos"] == roles["eef_pos"] == "proprioception"
    assert "object" in roles.values()


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


def test_an_unknown_reward_lists_the_rewards(lift: Task, lift_scene: Scene) -> None:
    text = "unknown reward 'sparse': .*known rewards: shaped, stock"
    with pytest.raises(UserError, match=text):
        native(lift, lift_scene, reward="sparse")


# Stock and native are the same process

SAME = ("observation", "reward", "reward_terms")
EQUAL = ("milestones", "success", "terminated", "truncated", "done")


@pytest.mark.parametrize("reward", ["shaped", "stock"])
def test_native_returns_what_stock_returns(
    reward: str, task: Task, scene: Scene
) -> None:
    theirs = TaskEnv(StockBatch(task, stock=scene.stock, reward=reward, seed=11))
    ours = native(task, scene, 2, reward=reward)
    begin_together(ours, theirs)
    for move in actions(10, 1):
        step_together(ours, theirs, move[:, : ours.batch.action_dim])


@pytest.mark.parametrize("name", ["Door", "Lift", "Reach"])
def test_native_returns_what_stock_returns_until_success(name: str, scene_of) -> None:
    """test_parity.py follows the measures of all tasks."""
    task = load_task(name)
    theirs = TaskEnv(StockBatch(task, stock=scene_of(task).stock, seed=11))
    ours = native(task, scene_of(task), 2)
    begin_together(ours, theirs)
    for _ in range(task.horizon):
        read = {k: v[:1] for k, v in ours.batch.engine.read().items()}
        move = task.expert(task.measure(read)).astype(np.float32)
        if step_together(ours, theirs, torch.from_numpy(move))["success"].all():
            return
    pytest.fail("the expert did not succeed")


def begin_together(ours: TaskEnv, theirs: TaskEnv) -> None:
    ours.reset()
    state = theirs.reset()
    copy_start(ours.batch.task, ours.batch.engine, range(2))
    assert_same(ours.observe(), state, ("observation", "reward_terms"))


def step_together(ours: TaskEnv, theirs: TaskEnv, move: Tensor) -> TensorDictBase:
    """Take an action [1, A] in stock and in both environments; stock's result."""
    after = theirs.step(TensorDict(action=move, batch_size=[1]))["next"]
    both = ours.step(TensorDict(action=move.expand(2, -1), batch_size=[2]))
    assert_same(both["next"], after, SAME)
    return after


def assert_same(ours, theirs, close: tuple[str, ...]) -> None:
    for env_id in range(2):
        for name in close:
            torch.testing.assert_close(
                ours[name][env_id], theirs[name][0], rtol=1e-5, atol=3e-5, msg=name
            )
        for name in EQUAL:
            assert torch.equal(ours[name][env_id], theirs[name][0]), name


# Ends of episodes


def test_a_time_limit_is_truncated(task: Task, scene: Scene) -> None:
    steps = run(native(task, scene, 3, horizon=4), actions(9, 3))
    ends = [step % 4 == 3 for step in range(9)]
    for name in "truncated", "done":
        flags = stacked(steps, "next", name)[:, :, 0]
        assert flags.tolist() == [[end] * 3 for end in ends]
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


# Seeds


def observed(env, moves: Tensor) -> Tensor:
    return stacked(run(env, moves), "after", "observation")


def test_episodes_do_not_depend_on_num_envs_and_threads(
    task: Task, scene: Scene
) -> None:
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
    assert not torch.isclose(env.reset()["observation"], first).all(-1).any()


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
    state, observations = env.observe(), []
    for move in moves:
        state["action"] = move[:, : env.action_spec.shape[-1]]
        _, state = env.step_and_maybe_reset(state)
        observations.append(state["observation"].clone())
    return torch.stack(observations)


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


# Options and arguments are checked in Python, too

WRONG_OPTIONS = [
    ({"num_envs": 0}, "num_envs must be at least 1, not 0"),
    ({"num_envs": 2.5}, "num_envs must be at least 1, not 2.5"),
    ({"num_envs": 10**11}, "num_envs must be at most"),
    ({"num_envs": None}, "num_envs must be at least 1, not None"),
    ({"horizon": 0}, "horizon must be at least 1, not 0"),
    ({"horizon": -5}, "horizon must be at least 1, not -5"),
    ({"horizon": 2.5}, "horizon must be at least 1, not 2.5"),
    ({"horizon": 10**11}, "horizon must be at most"),
    ({"threads": 0}, "threads must be at least 1, not 0"),
    ({"threads": 1.5}, "threads must be at least 1, not 1.5"),
    ({"seed": -1}, "seed must be a whole number from 0 to"),
    ({"seed": 0.5}, "seed must be a whole number from 0 to"),
    ({"seed": "1"}, "seed must be a whole number from 0 to"),
    ({"seed": None}, "seed must be a whole number from 0 to"),
    ({"seed": 2**64}, "seed must be a whole number from 0 to"),
    ({"purpose": 7}, "unknown purpose 7: choose one of 0 .TRAINING., 1"),
    ({"restart_fraction": -0.1}, "restart_fraction must be a number from 0 to 1"),
    ({"restart_fraction": 1.5}, "restart_fraction must be a number from 0 to 1"),
    ({"restart_fraction": np.nan}, "restart_fraction must be a number from 0 to 1"),
    ({"restart_fraction": "all"}, "restart_fraction must be a number from 0 to 1"),
    ({"fidelity": "fasst"}, "unknown fidelity 'fasst': did you mean 'fast'"),
    ({"reward": "sparse"}, "unknown reward 'sparse': known rewards: shaped"),
    ({"reward_weights": {"clsing": 1}}, "unknown reward term 'clsing': did you mean"),
    ({"reward_weights": {"closing": np.nan}}, "weight of reward term 'closing' must"),
    ({"reward_weights": {"closing": np.inf}}, "weight of reward term 'closing' must"),
    ({"reward_weights": {"closing": 1e9}}, "weight of reward term 'closing' must be"),
    ({"reward_weights": {"closing": "1"}}, "weight of reward term 'closing' must be"),
    ({"reward_weights": 3}, "reward_weights must be term=weight pairs, not 3"),
    ({"robot": "Pand"}, "unknown robot 'Pand': did you mean 'Panda'"),
    ({"robot": 5}, "robot must be a RobotConfig or an arm's name, not 5"),
    ({"robot": RobotConfig(control_freq=30)}, "control_freq 30 is not supported"),
    ({"robot": RobotConfig(controller="OSC")}, "unknown controller 'OSC'"),
    ({"backend": "stok"}, "unknown backend 'stok': did you mean 'stock'"),
]


@pytest.mark.parametrize(("options", "message"), WRONG_OPTIONS)
def test_options_out_of_range_are_refused(
    options: dict, message: str, tiny_scene: Scene
) -> None:
    """Where the robot is given, the scene must be built for it."""
    shared = {} if "robot" in options else {"scene": tiny_scene}
    with pytest.raises(UserError, match=message):
        make_batch(Tiny(), **({"num_envs": 2} | shared | options))


@pytest.mark.parametrize("seed", [-1, 1.5, 2**64, "1"])
def test_a_seed_out_of_range_is_refused_at_a_restart(seed, tiny_scene: Scene) -> None:
    batch = native(Tiny(), tiny_scene).batch
    with pytest.raises(UserError, match="seed must be a whole number"):
        batch.restart(seed)


def test_given_weights_replace_those_of_the_set(lift: Task, lift_scene: Scene) -> None:
    batch = native(lift, lift_scene, reward_weights={"lift": 0.0, "reach": 2.0}).batch
    assert batch.reward_weights == {"reach": 2.0, "grasp": 0.25, "lift": 0.0}
    batch.begin(np.arange(4))
    time_step = batch.step(actions(1, 4)[0].numpy())
    terms = time_step.reward_terms
    expected = 2.0 * terms["reach"] + 0.25 * terms["grasp"] + 0.0 * terms["lift"]
    np.testing.assert_allclose(time_step.reward, expected, rtol=1e-12)


def batches(scene: Scene, task: Task) -> dict[str, TaskBatch]:
    return {
        "native": NativeBatch(task, 1, scene=scene),
        "stock": StockBatch(task, stock=scene.stock),
    }


@pytest.mark.parametrize("backend", ["native", "stock"])
def test_a_step_before_the_first_reset_is_refused(
    backend: str, lift: Task, lift_scene: Scene
) -> None:
    batch = batches(lift_scene, lift)[backend]
    for _ in range(2):
        with pytest.raises(UserError, match=r"step\(\) was called before reset\(\)"):
            batch.step(np.zeros((1, 7)))
        batch.begin(np.zeros(1, int))
        batch.step(np.zeros((1, 7)))
        batch.restart()


@pytest.mark.parametrize("backend", ["native", "stock"])
@pytest.mark.parametrize(
    "action",
    [
        np.zeros((1, 6)), np.zeros(7), np.zeros((2, 7)), np.zeros((1, 7, 1)), 0.0,
        [["up"] * 7], None, np.zeros((1, 7), complex), [[0.0], [0.0, 1.0]],
    ],
)  # fmt: skip
def test_an_action_of_another_shape_or_kind_is_refused(
    action, backend: str, lift: Task, lift_scene: Scene
) -> None:
    batch = batches(lift_scene, lift)[backend]
    batch.begin(np.zeros(1, int))
    before = batch.elapsed.copy()
    with pytest.raises(UserError, match="the action"):
        batch.step(action)
    np.testing.assert_array_equal(batch.elapsed, before)


# Simulations that diverge


@pytest.mark.parametrize("part", [2, -1])
def test_a_diverged_environment_is_cut_off_and_restarts(
    part: int, task: Task, scene: Scene
) -> None:
    faulty, healthy = (native(task, scene, 3) for _ in range(2))
    moves = actions(4, 3)[..., : scene.layout.action_dim]
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


# Stock environments that are rebuilt


def test_a_hard_reset_is_read_from_its_new_simulation(lift: Task) -> None:
    stock = make_stock("Lift", seed=0, hard_reset=True)
    env, sizes = TaskEnv(StockBatch(lift, stock=stock)), set()
    for _ in range(2):
        observation = env.reset()["observation"][0]
        expected = stock_reader(stock, lift.sensors)()["cube_pos"][0]
        cube_pos = env.batch.observation_spec.split(observation)["cube_pos"].numpy()
        np.testing.assert_allclose(cube_pos / 4 + [0, 0, 0.8], expected, atol=1e-6)
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
        (
            "manip.tasks.lift:Lfit",
            "cannot import task 'manip.tasks.lift:Lfit': .*'Lfit'",
        ),
        (":Lift", "cannot import task ':Lift'"),
        (
            "pathlib:Path",
            "task 'pathlib:Path' must be a subclass of .*Task, not .*Path",
        ),
        (
            "manip.envs.task_registry:GROUP",
            "must be a class, not 'manip.tasks'",
        ),
    ],
)
def test_a_wrong_path_says_what_is_wrong(path: str, text: str) -> None:
    with pytest.raises(UserError, match=text):
        load_task(path)
