"""Numbers that go wrong: caught where they appear, named, kept, and no harm besides."""

from pathlib import Path

import numpy as np
import pytest
import torch
import toy
from tiny import Tiny
from toy import SPACES, Points, make_agent

from manip.agents.a2c import A2CConfig
from manip.agents.a3c import A3CConfig
from manip.agents.bc import BCConfig
from manip.envs.backends.native_batch import DUMP_FORMAT, MOST_DUMPS, NativeBatch
from manip.envs.task import Task
from manip.envs.task_batch import TimeStep
from manip.errors import UserError
from manip.io.tensor_trees import load_tree, save_tree
from manip.programs import cli, replay
from manip.sim.scene import Scene
from manip.training.collector import Rollout
from manip.training.nan_guard import NanGuard

Array = np.ndarray

N, SICK, WHEN = 64, 17, 2
"""TaskBatch; the one that falls ill; the step in which it does, counted from 0."""


def ill(m) -> Array:
    """Where an arm is turned by 2 rad and more."""
    return m["joint_pos"][:, 0] > 2


class IllSeen(Tiny):
    """An observation that is not finite where an arm is ill."""

    def observe(self, m):
        parts = super().observe(m)
        return parts | {"closing": np.where(ill(m)[:, None], np.inf, parts["closing"])}


class IllPaid(Tiny):
    """A reward that is not finite where an arm is ill."""

    def reward_terms(self, m, reward):
        terms = super().reward_terms(m, reward)
        return {"closing": np.where(ill(m), np.nan, terms["closing"])}


@pytest.fixture(scope="module")
def scene(scene_of) -> Scene:
    return scene_of(Tiny())


def played(worlds: NativeBatch, sick: str = "") -> list[TimeStep]:
    """Five steps; in the third, something happens to one world if it is to be sick."""
    worlds.begin(np.arange(worlds.num_envs))
    actions = np.random.default_rng(0).uniform(0.1, 1, (5, worlds.num_envs, 7))
    moments = []
    for number, action in enumerate(actions):
        if sick and number == WHEN:
            if sick == "action":
                action[SICK, 3] = np.nan
            elif sick == "physics":
                worlds.engine.states[SICK, worlds.scene.physics.nq + 2] = 1e7
            else:
                worlds.engine.states[SICK, 0] = 2.5
        moments.append(worlds.step(action))
        worlds.begin(np.flatnonzero(moments[-1].done))
    return moments


CASES = [
    ("physics", Tiny, "physics"),
    ("action", Tiny, "action"),
    ("observation", IllSeen, "observation 'closing'"),
    ("reward", IllPaid, "reward term 'closing'"),
]


@pytest.mark.parametrize(("part", "task", "what"), CASES)
def test_one_sick_world_of_many_is_named_and_costs_its_episode_only(
    part: str, task: type[Task], what: str, scene: Scene, tmp_path: Path, capsys
) -> None:
    worlds = NativeBatch(task(), N, scene=scene, dumps=tmp_path)
    healthy = played(NativeBatch(task(), N, scene=scene))
    moments = played(worlds, part)
    (fault,) = worlds.faults
    assert fault == (task.__name__, what, SICK, 0, WHEN + 1)
    others = np.arange(N) != SICK
    for time_step, well in zip(moments, healthy, strict=True):
        for name in ("observation", "reward", "success", "terminated", "truncated"):
            found, expected = (getattr(m, name) for m in (time_step, well))
            np.testing.assert_array_equal(found[others], expected[others])
            assert np.isfinite(found).all(), name
    assert moments[WHEN].truncated.tolist() == [world == SICK for world in range(N)]
    (dump,) = tmp_path.iterdir()
    assert cli.run(replay.main, [str(dump)]) == 1
    shown = capsys.readouterr().out
    assert f"then: {fault}" in shown
    assert f"now: {task.__name__}: {what} of world 0 is not finite in step" in shown
    assert "robot0_joint1" in shown


def test_a_replay_is_the_same_step(scene: Scene, tmp_path: Path, capsys) -> None:
    worlds = NativeBatch(Tiny(), 3, scene=scene, dumps=tmp_path)
    worlds.begin(np.arange(3))
    worlds.step(np.full((3, 7), 0.4))
    before = worlds.engine.save()
    action = np.full((3, 7), 0.4)
    action[1, 0] = np.nan
    worlds.step(action)
    (dump,) = tmp_path.iterdir()
    kept = load_tree(dump)
    kept["rig"] |= {"dumps": str(tmp_path / "elsewhere"), "num_envs": 9}
    again = replay._world(kept)
    np.testing.assert_array_equal(again.engine.states, before.states[[1]])
    np.testing.assert_array_equal(again.engine.save().readings, before.readings[[1]])


def test_a_fault_can_end_the_run_and_says_how_to_see_it_again(scene, tmp_path) -> None:
    worlds = NativeBatch(IllPaid(), N, scene=scene, dumps=tmp_path)
    worlds.stop_at_faults = True
    told = (
        f"IllPaid: reward term 'closing' of world {SICK} is not finite in step 3 of its"
    )
    with pytest.raises(UserError, match=f"{told} episode 0; manip replay {tmp_path}"):
        played(worlds, "reward")


def test_a_run_keeps_a_bounded_number_of_faults(scene: Scene, tmp_path: Path) -> None:
    worlds = NativeBatch(Tiny(), N, scene=scene, dumps=tmp_path)
    worlds.begin(np.arange(N))
    worlds.step(np.full((N, 7), np.nan))
    assert len(worlds.faults) == N
    assert len(list(tmp_path.iterdir())) == MOST_DUMPS


def test_what_is_no_kept_step_is_refused(tmp_path: Path, capsys) -> None:
    path = tmp_path / "dump.safetensors"
    assert cli.run(replay.main, [str(path)]) == 2
    save_tree(path, {"format": DUMP_FORMAT, "fault": {"a": 1}})
    assert cli.run(replay.main, [str(path)]) == 2
    assert "does not fit this version" in capsys.readouterr().err


QUICK = {name: value for name, value in vars(toy).items() if name.startswith("QUICK")}


def test_every_algorithm_is_looked_at() -> None:
    without = {A3CConfig, BCConfig}
    shipped = toy.ALGORITHMS
    assert {type(config) for config in QUICK.values()} == {*shipped} - without
    assert issubclass(shipped[A3CConfig], shipped[A2CConfig])


@pytest.mark.parametrize("config", QUICK.values(), ids=QUICK)
def test_a_gradient_that_is_not_finite_is_named_and_changes_no_weight(config) -> None:
    agent, other = make_agent(config, seed=0), make_agent(config, seed=0)
    guard = NanGuard(agent.optimisers(), stop=False)
    batch = Rollout(Points([20] * 32)).collect(agent.policy(), 20).batch
    agent.update(batch.clone())
    batch["next", "reward"][:] = torch.nan
    guard.finite(agent.update(batch))
    assert any("the gradient of the optimiser" in what for what in guard.lost)
    assert any("loss" in what for what in guard.lost)
    for module in agent.modules().values():
        assert all(tensor.isfinite().all() for tensor in module.state_dict().values())
    NanGuard(other.optimisers(), stop=True)
    with pytest.raises(UserError, match=r"gradient of the optimiser .* is not finite"):
        other.update(batch)


def test_finite_gradients_are_left_alone() -> None:
    weight = torch.nn.Parameter(torch.ones(SPACES.action_dim))
    optimiser = torch.optim.SGD([weight], 0.5)
    guard = NanGuard({"all": optimiser}, stop=True)
    weight.grad = torch.ones(1)
    optimiser.step()
    assert weight.item() == 0.5
    assert guard.finite({"loss": 1.5}) == {"loss": 1.5}
