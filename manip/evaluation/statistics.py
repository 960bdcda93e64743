"""Success rates with their uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist

Z = NormalDist().inv_cdf(0.975)
"""The normal distribution's 97.5 % quantile."""


@dataclass(frozen=True)
class Rate:
    """A share of episodes and its Wilson 95 % interval."""

    rate: float
    low: float
    high: float


def success_rate(successes: Sequence[bool]) -> Rate:
    """Share of true entries, with the Wilson score interval (Wilson 1927).

    (p + z^2/2n +- z sqrt(p (1 - p)/n + z^2/4n^2)) / (1 + z^2/n); written out, because
    importing scipy.stats takes longer than a training's first second.
    """
    total = len(successes)
    rate = sum(map(bool, successes)) / total
    centre = rate + Z**2 / (2 * total)
    half = Z * sqrt(rate * (1 - rate) / total + Z**2 / (4 * total**2))
    scale = 1 + Z**2 / total
    low, high = max(0.0, (centre - half) / scale), min(1.0, (centre + half) / scale)
    return Rate(rate, min(low, rate), max(high, rate))
