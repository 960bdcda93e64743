"""Choose pairs of clips to compare: at random, or by the ensemble's disagreement."""

import torch
from torch import Tensor

from manip.preferences.reward_network import RewardNetwork

Pairs = Tensor
"""[P, 2] int64, rows of the left and the right clip."""


def random_pairs(clips: int, count: int, generator: torch.Generator) -> Pairs:
    """Draw pairs of different clips; none is used again before all others are.

    Args:
        clips: number of clips, at least 2.
        count: number of pairs.
    """
    halves = clips // 2
    orders = [
        torch.randperm(clips, generator=generator)[: 2 * halves].view(halves, 2)
        for _ in range(-(-count // halves))
    ]
    return torch.cat(orders)[:count]


@torch.no_grad()
def disagreement(network: RewardNetwork, inputs: Tensor, pairs: Pairs) -> Tensor:
    """[P]: standard deviation over the members of P(left is better).

    Args:
        inputs: [C, L, F] of all clips.
    """
    sums = network.rewards(inputs).sum(-1)
    left, right = (sums[:, rows] for rows in pairs.unbind(1))
    return (left - right).sigmoid().std(0, correction=0)


def choose_pairs(
    count: int,
    inputs: Tensor,
    generator: torch.Generator,
    network: RewardNetwork | None = None,
    candidates: int = 10,
) -> Pairs:
    """Choose pairs of clips whose inputs are [C, L, F].

    Args:
        network: choose those of `candidates` times as many random pairs on which its
            members disagree most (Lee et al. 2021, arXiv 2106.05091); without it, the
            pairs are random.
    """
    if network is None:
        return random_pairs(len(inputs), count, generator)
    pairs = random_pairs(len(inputs), candidates * count, generator)
    order = disagreement(network, inputs, pairs).argsort(descending=True, stable=True)
    return _without_repeats(pairs[order])[:count]


def _without_repeats(pairs: Pairs) -> Pairs:
    """The pairs, each of two clips once, on whichever side they are."""
    first = {
        frozenset(pair): row for row, pair in reversed([*enumerate(pairs.tolist())])
    }
    return pairs[sorted(first.values())]
