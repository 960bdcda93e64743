"""TRPO: Fisher-vector products, the bound on a step, the search, learning."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.distributions import Normal, kl_divergence
from torch.func import functional_call
from toy import QUICK_TRPO, make_agent, mean_return, rollout_of, train

from manip.agents.trpo import TRPO, conjugate_gradients

SMALL = replace(QUICK_TRPO, actor_hidden=(4,), damping=0.0)


def agent_and_samples(config=SMALL, seed: int = 0) -> tuple[TRPO, TensorDictBase]:
    """An agent, and samples [B] with advantages and its policy's distribution."""
    agent = make_agent(config, seed)
    assert isinstance(agent, TRPO)
    samples = rollout_of(agent).reshape(-1)
    for name in ("advantage", "value_target"):
        samples[name] = torch.randn(len(samples), 1)
    return agent, agent._add_distribution(samples)


def fisher_by_hand(agent: TRPO, samples: TensorDictBase) -> Tensor:
    """Of a Gaussian: mean over states of J' J / std^2, and 2 for its log deviation."""
    body, state = agent.actor.body, samples["observation"]
    names = [name for name, _ in body.named_parameters()]
    params = tuple(p.detach() for p in body.parameters())

    def mean(*values: Tensor) -> Tensor:
        given = dict(zip(names, values, strict=True))
        return functional_call(body, given, (agent.actor.norm(state),)).squeeze(-1)

    parts = torch.autograd.functional.jacobian(mean, params)
    jacobian = torch.cat([part.flatten(1) for part in parts], -1)
    matrix = jacobian.T @ jacobian / len(state) / (2 * agent.actor.log_std).exp()
    return torch.block_diag(matrix.detach(), torch.tensor([[2.0]]))


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_products_are_those_with_the_fisher_matrix(damping: float) -> None:
    agent, samples = agent_and_samples(replace(SMALL, damping=damping))
    expected = fisher_by_hand(agent, samples)
    product = agent._fisher(samples)
    eye = torch.eye(len(expected))
    found = torch.stack([product(unit) for unit in eye])
    torch.testing.assert_close(found, expected + damping * eye, rtol=1e-4, atol=1e-5)


def test_conjugate_gradients_solve_a_positive_system() -> None:
    draw = torch.Generator().manual_seed(0)
    root = torch.randn(6, 6, generator=draw, dtype=torch.float64)
    matrix = root @ root.T + torch.eye(6, dtype=torch.float64)
    b = torch.randn(6, generator=draw, dtype=torch.float64)
    x = conjugate_gradients(lambda v: matrix @ v, b, steps=6)
    torch.testing.assert_close(x, torch.linalg.solve(matrix, b), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("max_kl", [0.001, 0.05])
def test_a_step_gains_within_the_trust_region(max_kl: float) -> None:
    for seed in range(5):
        config = replace(SMALL, max_kl=max_kl)
        agent, samples = agent_and_samples(config, seed)
        before = agent._objective(samples)
        logged = agent._improve(samples)
        old = Normal(samples["loc"], samples["scale"])
        new = Normal(*agent.actor(samples["observation"]))
        kl = kl_divergence(old, new).sum(-1).mean().item()
        assert logged["kl"] == pytest.approx(kl, rel=1e-3)
        assert 0 < kl <= max_kl * 1.001
        assert agent._objective(samples) < before


@pytest.mark.parametrize(("max_kl", "step"), [(0.0, 1.0), (1e9, -1.0)])
def test_a_step_that_breaks_the_bound_or_harms_is_taken_back(max_kl, step) -> None:
    agent, samples = agent_and_samples()
    agent.config = replace(SMALL, max_kl=max_kl, backtracks=3)
    loss = agent._objective(samples)
    before = agent._params.data.clone()
    ascent = -1e-2 * step * agent._gradient(loss)
    assert agent._search(samples, ascent, loss.item())["kl"] == 0
    assert torch.equal(agent._params.data, before)


def test_the_critic_alone_moves_where_no_action_is_better() -> None:
    agent, samples = agent_and_samples()
    samples["advantage"].zero_()
    actor, critic = (nn.utils.parameters_to_vector(m.parameters()).clone() for m in
                     (agent.actor, agent.critic))  # fmt: skip
    agent._improve(samples)
    agent._fit(samples)
    assert torch.equal(nn.utils.parameters_to_vector(agent.actor.parameters()), actor)
    after = nn.utils.parameters_to_vector(agent.critic.parameters())
    assert not torch.equal(after, critic)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_learns_to_go_to_the_goal(seed: int) -> None:
    assert mean_return(train(QUICK_TRPO, seed, steps=3200)) > 15.5
