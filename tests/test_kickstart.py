"""Kickstarting: the falling weight, its gradient, and SAC that stays near a policy."""

from dataclasses import replace

import pytest
import torch
from toy import QUICK_SAC, Points, make_agent

from manip.agents.kickstart import Kickstart
from manip.agents.networks import Actor
from manip.agents.sac import SAC
from manip.training.collector import Rollout


def actor_of(seed: int) -> Actor:
    torch.manual_seed(seed)
    return Actor(3, 2, (8,), squash=True, normalise=False)


def test_the_weight_falls_linearly_to_zero() -> None:
    kickstart = Kickstart(actor_of(0), weight=8.0, steps=100)
    assert [kickstart.weight(step) for step in (0, 25, 100, 500)] == [8, 6, 0, 0]


def test_the_gradient_is_that_of_the_weighted_distance() -> None:
    actor, other, states = actor_of(0), actor_of(1), torch.randn(5, 3)
    kickstart = Kickstart(actor, weight=8.0, steps=100)
    assert kickstart.add_gradient(0, states) == 0.0
    kickstart.start_from(other.state_dict())
    for parameter in actor.parameters():
        parameter.grad = torch.ones_like(parameter)
    distance = kickstart.add_gradient(25, states)
    actions = actor.decide(states) - other.decide(states)
    expected = actions.square().mean()
    assert distance == pytest.approx(expected.item())
    gradients = torch.autograd.grad(6 * expected, [*actor.parameters()])
    for parameter, gradient in zip(actor.parameters(), gradients, strict=True):
        torch.testing.assert_close(parameter.grad, gradient + 1)
    assert not any(p.requires_grad for p in kickstart.parameters())


def distance_after_learning(weight: float) -> float:
    """How far SAC goes from an initial policy that stands still."""
    config = replace(QUICK_SAC, random_steps=0, initial_weight=weight)
    agent = make_agent(config, seed=0)
    assert isinstance(agent, SAC)
    weights = {name: 0 * value for name, value in agent.actor.state_dict().items()}
    weights["action_scale"] += 1
    agent.start_from(weights, deviation=0.2)
    rollout = Rollout(Points([20] * 16))
    for _ in range(10):
        agent.update(rollout.collect(agent.policy(), agent.rollout_length).batch)
    states = torch.linspace(-1, 1, 21)[:, None]
    return agent.explorer.decide(states).square().mean().item()


def test_a_larger_weight_keeps_the_actor_nearer_to_its_initial_policy() -> None:
    free, near, nearer = map(distance_after_learning, (0.0, 3.0, 300.0))
    assert free > 2 * near > 4 * nearer
