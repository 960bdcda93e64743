"""Fit a reward to comparisons of clips (Bradley and Terry 1952; Christiano et al. 2017,
arXiv 1706.03741).

    P(left is better) = sigmoid(sum_t r(x_t, left) - sum_t r(x_t, right))
    loss = -E [y log P + (1 - y) log(1 - P)]

y is 1 for "left", 0 for "right", 1/2 for "equal"; skipped pairs are left out before.
Each member of the ensemble has its own initial weights and order of pairs. A part of
the pairs is held out: each member keeps the weights of its lowest loss on these, and
the fit ends when no member has improved for some epochs (early stopping).
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from manip.agents.compared_clips import ComparedClips
from manip.preferences.reward_network import RewardNetwork


@dataclass(frozen=True)
class FitOptions:
    """How a reward is fitted; the values were tuned on Lift (see docs/rlhf.md)."""

    learning_rate: float = 1e-3
    batch_size: int = 32
    held_out: float = 0.15
    patience: int = 8
    epochs: int = 100


class FitResult(NamedTuple):
    """How well a fitted reward predicts answers.

    Attributes:
        accuracy: share of the held-out pairs, without equal ones, whose better clip has
            the higher sum of rewards.
        loss: Bradley-Terry loss on the held-out pairs [nat].
        held_out: number of these pairs.
    """

    accuracy: float
    loss: float
    held_out: int


def logits(network: RewardNetwork, pairs: ComparedClips) -> Tensor:
    """[K, B]: sum of rewards of the left clip minus that of the right, by member.

    Args:
        pairs: [B, L, F] inputs, or [K, B, L, F] with other pairs for each member.
    """
    left, right = (_sums(network, part) for part in (pairs.left, pairs.right))
    return left - right


def _sums(network: RewardNetwork, clips: Tensor) -> Tensor:
    rewards: Tensor = network(clips.flatten(-3, -2))
    return rewards.unflatten(1, clips.shape[-3:-1]).sum(-1)


def losses(logit: Tensor, target: Tensor) -> Tensor:
    """Bradley-Terry loss [K] of logits [K, B] for targets [B] or [K, B]."""
    each = nn.functional.binary_cross_entropy_with_logits(
        logit, target.expand_as(logit), reduction="none"
    )
    return each.mean(-1)


def fit(
    network: RewardNetwork,
    pairs: ComparedClips,
    generator: torch.Generator,
    options: FitOptions | None = None,
) -> FitResult:
    """Train a network on pairs, with early stopping on those that it holds out.

    Args:
        generator: draws the pairs that are held out and their order in each epoch.
    """
    options = options or FitOptions()
    order = torch.randperm(len(pairs), generator=generator)
    count = max(1, round(options.held_out * len(order)))
    held_out, training = pairs.at(order[:count]), pairs.at(order[count:])
    if not len(training):
        training = held_out
    keeper = _BestWeights(network)
    optimiser = torch.optim.Adam(network.parameters(), options.learning_rate)
    for _ in range(options.epochs):
        _epoch(network, training, optimiser, options.batch_size, generator)
        if keeper.epochs_without_progress(held_out) >= options.patience:
            break
    keeper.restore()
    return evaluate(network, held_out)


def _epoch(
    network: RewardNetwork,
    pairs: ComparedClips,
    optimiser: torch.optim.Optimizer,
    batch_size: int,
    generator: torch.Generator,
) -> None:
    """One pass over the pairs, in another order for each member."""
    members, count = len(network.weights[0]), len(pairs)
    order = torch.rand(members, count, generator=generator).argsort(1)
    for rows in order.split(batch_size, 1):
        batch = pairs.at(rows)
        optimiser.zero_grad()
        losses(logits(network, batch), batch.target).sum().backward()
        optimiser.step()


@torch.no_grad()
def evaluate(network: RewardNetwork, pairs: ComparedClips) -> FitResult:
    """How well the mean of the members predicts the answers."""
    logit = logits(network, pairs).mean(0)
    decided = pairs.target != 0.5
    right = (logit > 0) == (pairs.target > 0.5)
    return FitResult(
        accuracy=right[decided].float().mean().item() if decided.any() else 0.5,
        loss=losses(logit[None], pairs.target).item(),
        held_out=len(pairs),
    )


class _BestWeights:
    """Keep, for each member of an ensemble, the weights of its lowest loss."""

    def __init__(self, network: RewardNetwork) -> None:
        self._network = network
        self._lowest = torch.full((len(network.weights[0]),), torch.inf)
        self._weights = [weight.detach().clone() for weight in network.parameters()]
        self._stale = 0

    @torch.no_grad()
    def epochs_without_progress(self, held_out: ComparedClips) -> int:
        """Compare the present weights; return for how long none has improved."""
        present = losses(logits(self._network, held_out), held_out.target)
        better = present < self._lowest
        self._lowest = torch.where(better, present, self._lowest)
        for best, now in zip(self._weights, self._network.parameters(), strict=True):
            best[better] = now[better]
        self._stale = 0 if better.any() else self._stale + 1
        return self._stale

    @torch.no_grad()
    def restore(self) -> None:
        """Put the best weights back."""
        for best, now in zip(self._weights, self._network.parameters(), strict=True):
            now.copy_(best)
