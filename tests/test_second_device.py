"""PPO and SAC on another device than the CPU: nothing is left on the CPU."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from second_batch import SecondBatch
from second_device import CPU, SECOND, seeded_generator
from tensordict import TensorDictBase
from toy import QUICK_PPO, QUICK_SAC, SPACES, Points, make_agent, rollout_of
from training_runs import finished, new_trainer, tiny

from manip.agents import exploration, on_policy
from manip.agents.agent import Agent
from manip.agents.policy import load_policy
from manip.agents.ppo import PPO
from manip.agents.sac import SAC
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task_batch import TaskBatch
from manip.envs.task_registry import load_task
from manip.evaluation.episodes import run_episodes
from manip.io.tensor_trees import load_tree
from manip.training import build, run_parts
from manip.training.build import host_actor
from manip.training.collector import Rollout

FEW_EPOCHS = replace(QUICK_PPO, epochs=2)
SAC_AT_ONCE = replace(QUICK_SAC, random_steps=0, updates_per_step=0.05)
AGENTS = {"ppo": (PPO, FEW_EPOCHS), "sac": (SAC, SAC_AT_ONCE)}

both = pytest.mark.parametrize("algo", [*AGENTS])


@pytest.fixture(autouse=True)
def generators(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (exploration, on_policy):
        monkeypatch.setattr(module, "seeded_generator", seeded_generator)


def agent_on(algo: str, device: torch.device, gradients: str = "torchrl") -> Agent:
    torch.manual_seed(0)
    algorithm, config = AGENTS[algo]
    return algorithm(config, SPACES, gradients=gradients, device=device)


def tensors(tree: object) -> Iterator[torch.Tensor]:
    if isinstance(tree, torch.Tensor):
        yield tree
    for child in tree.values() if isinstance(tree, dict) else ():
        yield from tensors(child)


def learned(agent: Agent, batches: list[TensorDictBase]) -> list[dict[str, float]]:
    torch.manual_seed(3)
    return [agent.update(batch.clone()) for batch in batches]


@both
def test_losses_on_a_device_are_those_of_native_gradients(algo: str) -> None:
    batches = [rollout_of(make_agent(QUICK_PPO, seed)) for seed in (0, 1)]
    native = agent_on(algo, CPU, "native")
    expected = learned(native, batches)
    for device in (CPU, SECOND):
        agent = agent_on(algo, device)
        for losses, others in zip(learned(agent, batches), expected, strict=True):
            assert losses == pytest.approx(others, rel=1e-5, abs=1e-6)
        parts = [module.state_dict() for module in agent.modules().values()]
        assert {t.device for part in parts for t in tensors(part)} == {device}
        state = agent.extra_state()
        assert {t.device for t in tensors(state)} <= {device}


@both
def test_actions_return_to_the_environments(algo: str) -> None:
    policy = agent_on(algo, SECOND).policy()
    batch = Rollout(Points([3, 5, 50])).collect(policy, 4).batch
    assert {value.device for value in batch.values(True, True)} == {CPU}


@both
def test_policies_are_evaluated_on_the_cpu(algo: str) -> None:
    agent = agent_on(algo, SECOND)
    actor, twin = host_actor(agent), agent_on(algo, CPU).actor
    seen = torch.rand(5, 1)
    torch.testing.assert_close(actor.decide(seen), twin.decide(seen))
    assert host_actor(agent_on(algo, CPU)) is not actor
    run_episodes(Points([3, 5]), lambda parts: actor.decide(parts["x"]), 2)


def make_batch(task: str, num_envs: int, **options: Any) -> TaskBatch:
    """Of training, on the second device; of evaluations, on the host."""
    kind = SecondBatch if options.get("stagger") else NativeBatch
    return kind(load_task(task), num_envs, **options)


@pytest.mark.slow
@pytest.mark.parametrize("task_there", [False, True])
@both
def test_a_run_on_a_device_is_that_on_the_cpu(
    algo: str, task_there: bool, tmp_path: Path
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_parts, "learner_device", lambda _: SECOND)
        if task_there:
            patch.setattr(build, "make_batch", make_batch)
        trainer = new_trainer(tiny(algo, tmp_path / "run"))
        assert trainer.run()
    policy, expected = (
        load_policy(folder).actor.state_dict()
        for folder in (tmp_path / "run", finished(algo).folder)
    )
    for name, weight in policy.items():
        torch.testing.assert_close(weight, expected[name], rtol=1e-3, atol=1e-4)
    saved = load_tree(trainer.checkpoints.latest)
    assert {tensor.device for tensor in tensors(saved)} == {CPU}
    more = replace(trainer.config, steps=640, resume=True)
    resumed = new_trainer(more)  # on the CPU
    assert resumed.run()
    assert resumed.state.env_steps >= 640
