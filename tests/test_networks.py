"""Networks: running statistics, actors' ranges, initial weights."""

import math

import numpy as np
import pytest
import torch
from torch import nn

from manip.agents.networks import Actor, RunningNorm, mlp, orthogonal
from manip.errors import UserError


def pieces(count: int = 7, width: int = 4) -> list[torch.Tensor]:
    """Batches of different sizes, places and spreads; the first one is a single row."""
    rng = np.random.default_rng(0)
    return [
        torch.from_numpy(rng.normal(3.0 * i, 1 + i, (1 + 11 * i, width))).float()
        for i in range(count)
    ]


def test_running_norm_equals_numpy_over_everything_seen() -> None:
    norm, pieces_so_far = RunningNorm(4), []
    for piece in pieces():
        norm.update(piece)
        pieces_so_far.append(piece.numpy())
        everything = np.concatenate(pieces_so_far).astype(np.float64)
        assert norm.count == len(everything)
        np.testing.assert_allclose(norm.mean, everything.mean(0), rtol=1e-5)
        np.testing.assert_allclose(norm.var, everything.var(0), rtol=1e-5)


def test_running_norm_takes_rollouts_as_it_takes_rows() -> None:
    rows, rollout = RunningNorm(3), RunningNorm(3)
    x = torch.randn(6, 5, 3, generator=torch.Generator().manual_seed(0))
    rows.update(x.reshape(30, 3))
    rollout.update(x)
    assert torch.equal(rows.mean, rollout.mean)
    assert torch.equal(rows.var, rollout.var)


def test_running_norm_standardises_what_it_has_seen_and_clips_the_rest() -> None:
    norm = RunningNorm(4)
    x = torch.cat(pieces())
    norm.update(x)
    torch.testing.assert_close(norm(x).mean(0), torch.zeros(4), atol=1e-4, rtol=0)
    torch.testing.assert_close(norm(x).var(0), torch.ones(4), atol=1e-2, rtol=0)
    assert norm(x + 1e6).unique().tolist() == [10.0]
    assert norm(x - 1e6).unique().tolist() == [-10.0]


def test_running_norm_is_saved_with_its_actor() -> None:
    actor, other = (Actor(4, 2, (8,), squash=False, normalise=True) for _ in range(2))
    x = torch.cat(pieces())
    actor.norm.update(x)
    other.load_state_dict(actor.state_dict())
    assert torch.equal(other.norm(x), actor.norm(x))
    assert not torch.equal(other.norm(x), RunningNorm(4)(x))


@pytest.mark.parametrize("squash", [False, True])
@pytest.mark.parametrize("normalise", [False, True])
def test_actor_is_a_gaussian_whose_decision_is_in_range(squash, normalise) -> None:
    actor = Actor(4, 2, (8, 8), squash, normalise)
    for parameter in actor.body.parameters():
        parameter.data.mul_(300.0)
    observation = 5 * torch.randn(3, 6, 4, generator=torch.Generator().manual_seed(0))
    loc, std = actor(observation)
    assert loc.shape == std.shape == (3, 6, 2)
    assert (std > 0).all()
    decision = actor.decide(observation)
    assert loc.abs().max() > 1
    expected = loc.tanh() if squash else loc.clamp(-1, 1)
    assert torch.equal(decision, expected)


def test_squashed_deviation_stays_between_e_to_the_minus_5_and_e_squared() -> None:
    actor = Actor(1, 1, (4,), squash=True, normalise=False)
    for bias, limit in ((-1e3, math.exp(-5)), (1e3, math.exp(2))):
        nn.init.constant_(actor.body[-1].bias, bias)
        _, std = actor(torch.zeros(1, 1))
        assert std.item() == pytest.approx(limit, rel=1e-5)


@pytest.mark.parametrize("squash", [False, True])
def test_action_scale_bounds_the_part_of_the_range_that_is_used(squash) -> None:
    scale = (1.0, 0.5, 0.1)
    actor = Actor(4, 3, (8,), squash, normalise=False, action_scale=scale)
    full = Actor(4, 3, (8,), squash, normalise=False)
    full.load_state_dict(actor.state_dict() | {"action_scale": torch.ones(3)})
    observation = torch.randn(50, 4, generator=torch.Generator().manual_seed(0))
    expected = torch.tensor(scale) * full.decide(observation)
    torch.testing.assert_close(actor.decide(observation), expected)


def test_action_scale_of_another_length_is_refused() -> None:
    with pytest.raises(UserError, match="action_scale has 2 numbers, the action has 3"):
        Actor(4, 3, (8,), squash=True, normalise=False, action_scale=(1.0, 0.5))


def test_layer_norm_stands_between_each_linear_and_its_activation() -> None:
    kinds = [type(layer) for layer in mlp(3, 1, (8, 8), nn.Tanh, layer_norm=True)]
    hidden = [nn.Linear, nn.LayerNorm, nn.Tanh]
    assert kinds == [*hidden, *hidden, nn.Linear]


def test_orthogonal_weights_keep_lengths_times_the_gain() -> None:
    network = mlp(8, 2, (8,))
    orthogonal(network, gain=2.0, last_gain=0.01)
    for layer, gain in ((network[0], 2.0), (network[-1], 0.01)):
        rows = layer.weight @ layer.weight.T
        torch.testing.assert_close(rows, gain**2 * torch.eye(len(rows)))
        assert not layer.bias.any()


def test_ppo_starts_near_zero_action() -> None:
    actor = Actor(4, 2, (64, 64), squash=False, normalise=False)
    observation = torch.randn(100, 4, generator=torch.Generator().manual_seed(0))
    assert actor.decide(observation).abs().max() < 0.1
