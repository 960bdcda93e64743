"""REINFORCE and A2C: returns and gradients by hand, learning."""

import math
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.distributions import Normal
from torchrl.modules import ValueOperator
from toy import (
    QUICK_A2C,
    QUICK_PPO,
    QUICK_PPO_KL,
    QUICK_REINFORCE,
    make_agent,
    mean_return,
    rollout_of,
    three_steps,
    train,
)

from manip.agents.agent import AgentConfig
from manip.agents.on_policy import OnPolicy
from manip.agents.value_targets import add_values, n_step_advantages
from manip.errors import UserError

IDENTITY = ValueOperator(nn.Identity(), in_keys=["observation"])
"""V(s) = s."""

RETURNS = [
    # To the end of episode or rollout, and V there: 1 + .9 (2 + .9 * 4), ...
    (None, False, [6.04, 5.6, 5.25]),
    (None, True, [2.8, 2.0, 5.25]),
    (1, False, [1.9, 5.6, 5.25]),
    (1, True, [1.9, 2.0, 5.25]),
    (2, False, [6.04, 5.6, 5.25]),
    (2, True, [2.8, 2.0, 5.25]),
]


@pytest.mark.parametrize(("n", "terminated", "expected"), RETURNS)
def test_returns_of_three_steps(n, terminated: bool, expected: list[float]) -> None:
    batch = add_values(three_steps(terminated), IDENTITY)
    if n is None:
        config = replace(QUICK_REINFORCE, gamma=0.9)
        make_agent(config, seed=0)._returns(batch)
    else:
        n_step_advantages(batch, n, gamma=0.9, critic=IDENTITY)
    target = torch.tensor(expected).view(1, 3, 1)
    torch.testing.assert_close(batch["value_target"], target)
    torch.testing.assert_close(batch["advantage"], target - batch["observation"])


def unclipped(config: AgentConfig, **changes: object) -> OnPolicy:
    """An agent whose gradients are as the loss has them."""
    agent = make_agent(replace(config, max_gradient=1e9, **changes), seed=0)
    assert isinstance(agent, OnPolicy)
    agent.actor.norm.update(torch.randn(50, 1))
    return agent


def terms(agent: OnPolicy, batch: TensorDictBase) -> tuple[Tensor, Tensor, Tensor]:
    """log pi(a | s), (V - R)^2 and the entropy, all [N, T, 1]."""
    distribution = Normal(*agent.actor(batch["observation"]))
    log_prob = distribution.log_prob(batch["action"]).sum(-1, keepdim=True)
    value = agent.critic.module(batch["observation"])
    error = (value - batch["value_target"]).square()
    return log_prob, error, distribution.entropy().sum(-1, keepdim=True)


def assert_gradient(agent: OnPolicy, loss: Tensor) -> None:
    """The agent's last step went down this loss's gradient."""
    found = agent._params.grad.clone()
    agent._params.grad.zero_()
    loss.backward()
    assert found.abs().max() > 0
    torch.testing.assert_close(found, agent._params.grad, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("baseline", [True, False])
def test_reinforce_follows_log_probabilities_times_returns(baseline: bool) -> None:
    agent = unclipped(QUICK_REINFORCE, baseline=baseline, learning_rate=0.0)
    batch = add_values(rollout_of(agent), agent.critic)
    agent._learn(batch)
    log_prob, error, _ = terms(agent, batch)
    weight = batch["value_target"] - baseline * batch["state_value"]
    assert_gradient(agent, (0.5 * error - log_prob * weight).mean())


@pytest.mark.parametrize("n_step", [None, 2])
def test_a2c_follows_advantages_and_entropy(n_step: int | None) -> None:
    agent = unclipped(QUICK_A2C, n_step=n_step, learning_rate=0.0)
    batch = add_values(rollout_of(agent), agent.critic)
    agent._learn(batch)
    log_prob, error, entropy = terms(agent, batch)
    gain = log_prob * batch["advantage"] + 0.002 * entropy
    assert_gradient(agent, (0.5 * error - gain).mean())


def test_no_more_rewards_are_summed_up_than_a_rollout_has() -> None:
    with pytest.raises(UserError, match="n_step is 9, but a rollout has 8 steps"):
        make_agent(replace(QUICK_A2C, n_step=9), seed=0)


@pytest.mark.parametrize("config", [QUICK_A2C, QUICK_PPO, QUICK_PPO_KL])
def test_the_entropy_bonus_can_be_left_out(config: AgentConfig) -> None:
    agent = make_agent(replace(config, entropy_coefficient=0.0), seed=0)
    before = agent._params.detach().clone()
    logged = agent.update(rollout_of(agent))
    assert all(map(math.isfinite, logged.values()))
    assert not torch.equal(agent._params, before)


@pytest.mark.parametrize(
    "config", [QUICK_REINFORCE, replace(QUICK_REINFORCE, baseline=False)]
)
def test_reinforce_learns_to_go_to_the_goal(config: AgentConfig) -> None:
    assert mean_return(make_agent(config, seed=0)) < 12
    assert mean_return(train(config, seed=0, steps=6400)) > 15.5


@pytest.mark.parametrize("n_step", [None, 5])
def test_a2c_learns_to_go_to_the_goal(n_step: int | None) -> None:
    config = replace(QUICK_A2C, n_step=n_step)
    assert mean_return(train(config, seed=0, steps=3200)) > 15.5
