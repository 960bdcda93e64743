"""Environments: TorchRL's contract, equal to stock, the task registry."""

import numpy as np
import pytest
import torch
from rollouts import actions, native
from scripted import TASKS
from tensordict import TensorDict, TensorDictBase
from tiny import Tiny
from torch import Tensor
from torchrl.envs.utils import check_env_specs
from twin import copy_start

from manip.envs.adapters.torchrl import TaskEnv
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
    for move in actions(10, 1, scene=scene):
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


def test_an_action_may_need_gradients(tiny_scene: Scene) -> None:
    """As in TorchRL's own environments, it is detached."""
    env = native(Tiny(), tiny_scene)
    state = env.reset()
    state["action"] = torch.zeros(*env.batch_size, 7, requires_grad=True)
    assert not env.step(state)["next", "observation"].requires_grad
