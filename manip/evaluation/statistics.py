"""Success rates with their uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import binomtest


@dataclass(frozen=True)
class Rate:
    """A share of episodes and its Wilson 95 % interval."""

    rate: float
    low: float
    high: float


def success_rate(successes: Sequence[bool]) -> Rate:
    """Share of true entries, with the Wilson score interval (Wilson 1927)."""
    count, total = sum(map(bool, successes)), len(successes)
    interval = binomtest(count, total).proportion_ci(method="wilson")
    return Rate(count / total, float(interval.low), float(interval.high))
