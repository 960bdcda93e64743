"""PPO-KL: the penalised objective by hand, beta, the reference, learning."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.distributions import Normal, kl_divergence
from toy import QUICK_PPO_KL, make_agent, mean_return, rollout_of, train

from manip.agents.policy import Policy
from manip.agents.policy_card import PolicyCard
from manip.agents.ppo_kl import PPOKL, PPOKLConfig
from manip.agents.value_targets import add_values
from manip.errors import UserError
from manip.training.build import build_agent, evaluation_env, policy_of
from manip.training.config import from_dict


def agent_of(config: PPOKLConfig = QUICK_PPO_KL, seed: int = 0) -> PPOKL:
    agent = make_agent(config, seed)
    assert isinstance(agent, PPOKL)
    return agent


def test_the_objective_pays_for_the_distance_to_the_old_policy() -> None:
    agent = agent_of(replace(QUICK_PPO_KL, beta=3.0))
    batch = rollout_of(agent).reshape(-1)
    batch["advantage"], batch["value_target"] = torch.randn(2, len(batch), 1)
    agent._add_distribution(batch)
    for parameter in agent.actor.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape)
    old = Normal(batch["loc"], batch["scale"])
    new = Normal(*agent.actor(batch["observation"]))
    ratio = (new.log_prob(batch["action"]) - old.log_prob(batch["action"])).exp()
    advantage = batch["advantage"]
    advantage = (advantage - advantage.mean()) / advantage.std()
    expected = (ratio * advantage - 3.0 * kl_divergence(old, new)).mean()
    found = agent._loss(batch)["loss_objective"]
    torch.testing.assert_close(found, -expected)


@pytest.mark.parametrize(
    ("target", "factor"), [(0.004, 2.0), (0.01, 1.0), (0.03, 0.5), (None, 1.0)]
)
def test_beta_follows_the_divergence_of_an_update(target, factor: float) -> None:
    """The mean moves by 0.1 and a deviation of e^-0.5: KL = 0.005 e = 0.0136."""
    agent = agent_of(replace(QUICK_PPO_KL, target_kl=target, beta=4.0))
    batch = rollout_of(agent).reshape(-1)
    batch["advantage"], batch["value_target"] = torch.randn(2, len(batch), 1)
    agent._add_distribution(batch)
    agent.actor.body[-1].bias.data += 0.1
    logged = agent._adapt(batch)
    assert logged["kl"] == pytest.approx(0.0136, rel=0.01)
    assert logged["beta"] == 4.0 * factor


def part(name: str, width: int) -> dict[str, Any]:
    return {"name": name, "shape": [width], "dtype": "float32", "role": "object"}


def save_policy(agent: PPOKL, folder: Path) -> str:
    card = PolicyCard(
        task="Reach", robot="Panda", algo="ppo", controller="OSC_POSE",
        control_freq=20, action_dim=1, observation=[part("x", 1)], hidden=[32],
        squash=False, normalise=True, env_steps=0, seed=0, versions={},
    )  # fmt: skip
    Policy(card, agent.actor).save(folder)
    return str(folder)


def test_a_run_starts_from_its_reference_and_pays_for_leaving_it(tmp_path) -> None:
    trained = agent_of(seed=1)
    trained.actor.body[-1].bias.data += 0.5
    reference = save_policy(trained, tmp_path)
    config = replace(QUICK_PPO_KL, reference=reference, reference_beta=0.2)
    agent, state = agent_of(config), torch.linspace(-1, 1, 9)[:, None]
    assert torch.equal(agent.actor.decide(state), trained.actor.decide(state))
    assert agent._penalise(rollout_of(agent))["kl_reference"] == pytest.approx(0)
    agent.actor.log_std.data += 0.3
    batch = rollout_of(agent)
    paid, observation = batch["next", "reward"].clone(), batch["observation"]
    agent._penalise(batch)
    policies = [Normal(*actor(observation)) for actor in (agent.actor, trained.actor)]
    new, old = (policy.log_prob(batch["action"]) for policy in policies)
    expected = paid - 0.2 * (new - old)
    torch.testing.assert_close(batch["next", "reward"], expected.detach())


def test_the_reference_does_not_learn(tmp_path) -> None:
    config = replace(QUICK_PPO_KL, reference=save_policy(agent_of(seed=1), tmp_path))
    agent = agent_of(config)
    before = {k: v.clone() for k, v in agent._reference.state_dict().items()}
    agent.update(add_values(rollout_of(agent), agent.critic))
    after = agent._reference.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    assert not torch.equal(agent.actor.log_std, before["log_std"])


def test_a_reference_of_other_networks_is_refused(tmp_path) -> None:
    reference = save_policy(agent_of(), tmp_path)
    with pytest.raises(UserError, match="has other networks than this run"):
        agent_of(replace(QUICK_PPO_KL, reference=reference, actor_hidden=(16,)))


def test_a_run_that_goes_on_keeps_its_reference(tmp_path) -> None:
    config = replace(QUICK_PPO_KL, reference=save_policy(agent_of(seed=1), tmp_path))
    agent = agent_of(config)
    before = {name: m.state_dict() for name, m in agent.modules().items()}
    save_policy(agent_of(seed=2), tmp_path)
    again = agent_of(config)
    first, second = (next(a._reference.body.parameters()) for a in (agent, again))
    assert not torch.equal(second, first)
    for name, module in again.modules().items():
        module.load_state_dict(before[name])
    assert torch.equal(second, first)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"observation": [part("x", 26)]}, "another observation .*: x is missing"),
        ({"robot": "Sawyer"}, "was trained with robot Sawyer, not Panda"),
        ({"control_freq": 10}, "was trained with control_freq 10, not 20"),
    ],
)
def test_a_reference_of_another_arm_or_task_is_refused(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    config = from_dict({"task": "Reach", "algo": "ppo-kl", "num_envs": 1})
    env = evaluation_env(replace(config, eval_episodes=1))
    policy = policy_of(build_agent(config, env), config, env, 0)
    replace(policy, card=replace(policy.card, **changes)).save(tmp_path)
    agent = replace(config.agent, reference=str(tmp_path))
    with pytest.raises(UserError, match=message):
        build_agent(replace(config, agent=agent), env)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_learns_to_go_to_the_goal(seed: int) -> None:
    assert mean_return(train(QUICK_PPO_KL, seed, steps=3200)) > 15.5


def test_beta_waits_until_the_actor_learns() -> None:
    """An actor that does not move would halve beta in every rollout."""
    agent = agent_of(replace(QUICK_PPO_KL, critic_rollouts=2, beta=4.0))
    betas = [agent.update(rollout_of(agent)).get("beta") for _ in range(3)]
    assert betas[:2] == [None, None]
    assert betas[2] is not None


def test_with_a_reference_an_update_ends_when_it_has_gone_too_far(tmp_path) -> None:
    reference = save_policy(agent_of(seed=1), tmp_path)
    config = replace(QUICK_PPO_KL, reference=reference, epochs=20, target_kl=1e-6)
    steps = []
    for near in (config, replace(config, target_kl=None)):
        agent = agent_of(near)
        agent.update(rollout_of(agent))
        steps.append(next(iter(agent._optim.state.values()))["step"].item())
    assert steps[0] == steps[1] / 20
