"""Success rates with their uncertainty, over episodes and over training seeds."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from statistics import NormalDist
from typing import Literal, NamedTuple

import numpy as np

from manip.errors import UserError

Array = np.ndarray

Z = NormalDist().inv_cdf(0.975)
"""97.5 % quantile of the normal distribution."""

RESAMPLES = 10_000
"""Bootstrap samples of an interval over seeds."""

LEVEL = 0.04
"""Nominal one-sided level of `compare_seeds`.

Success rates are skewed, so the rate of false alarms is a little above the nominal
level. At 4 % it stays below 5 % (see tests/test_statistics.py).
"""

Comparison = Literal["agrees", "worse", "better", "cannot tell"]


@dataclass(frozen=True)
class Rate:
    """A share of episodes and its 95 % interval."""

    rate: float
    low: float
    high: float


@dataclass(frozen=True)
class Mean:
    """A mean over episodes and its 95 % interval."""

    mean: float
    low: float
    high: float


class SeedCount(NamedTuple):
    """Successful episodes of one training seed, and its evaluation episodes."""

    successes: int
    episodes: int


def success_rate(successes: Sequence[bool]) -> Rate:
    """Share of true entries, with its Wilson interval (see `wilson_rate`)."""
    return wilson_rate(sum(map(bool, successes)), len(successes))


def wilson_rate(successes: int, episodes: int) -> Rate:
    """Success rate of one policy; the interval covers the choice of episodes only.

    Wilson score interval (Wilson 1927), written out because importing scipy.stats
    takes longer than the first second of a training run:
    (p + z^2/2n +- z sqrt(p (1 - p)/n + z^2/4n^2)) / (1 + z^2/n).

    Raises:
        UserError: there are no episodes, or more successes than episodes.
    """
    _check_counts([SeedCount(successes, episodes)])
    rate = successes / episodes
    centre = rate + Z**2 / (2 * episodes)
    half = Z * sqrt(rate * (1 - rate) / episodes + Z**2 / (4 * episodes**2))
    scale = 1 + Z**2 / episodes
    low, high = max(0.0, (centre - half) / scale), min(1.0, (centre + half) / scale)
    return Rate(rate, min(low, rate), max(high, rate))


def mean_over_episodes(values: Sequence[float]) -> Mean:
    """Mean of one policy's episodes, with Student's t interval: mean +- t s / sqrt(n).

    The interval covers the choice of episodes only; of one episode it is the mean.

    Raises:
        UserError: there are no episodes.
    """
    if not values:
        raise UserError("a mean needs at least one episode")
    mean, count = float(np.mean(values)), len(values)
    half = student_half_width(values) if count > 1 else 0.0
    return Mean(mean, mean - half, mean + half)


def student_half_width(values: Sequence[float]) -> float:
    """Half the width of Student's 95 % interval of a mean of n >= 2 values.

    t_{0.975, n - 1} s / sqrt(n),   s^2 = sum (x - mean)^2 / (n - 1)
    """
    from scipy.special import stdtrit  # takes 0.4 s to import

    critical = float(stdtrit(len(values) - 1, 0.975))
    return critical * float(np.std(values, ddof=1)) / sqrt(len(values))


def rate_over_seeds(counts: Sequence[SeedCount]) -> Rate:
    """Mean success rate of S training seeds; the interval covers seeds and episodes.

    Hierarchical bootstrap (Davison & Hinkley 1997, section 3.8): draw S seeds with
    replacement, then a rate for each from its Jeffreys posterior
    Beta(k + 1/2, n - k + 1/2), which has a width also where all episodes succeeded.
    The distances from the mean are multiplied by sqrt(S / (S - 1)), because the spread
    of S resampled seeds is too small by this factor. For rates spread as Lift's are,
    95 % intervals of 3, 5 and 10 seeds cover 93, 94 and 95 %.

    With one seed there is no spread to measure: the result is `wilson_rate`.

    Raises:
        UserError: there are no seeds, or one without episodes.
    """
    _check_counts(counts)
    mean = sum(c.successes / c.episodes for c in counts) / len(counts)
    if len(counts) == 1:
        return wilson_rate(*counts[0])
    low, high = np.quantile(_resampled_means(counts), (0.025, 0.975))
    widen = sqrt(len(counts) / (len(counts) - 1))
    low, high = mean - widen * (mean - low), mean + widen * (high - mean)
    return Rate(mean, float(np.clip(low, 0, mean)), float(np.clip(high, mean, 1)))


def difference_of_rates(new: Sequence[SeedCount], stored: Sequence[SeedCount]) -> Rate:
    """Rate of one group of seeds minus that of another, with its 95 % interval.

    The intervals of both rates p and q (`rate_over_seeds`), squared and added (method
    10 of Newcombe 1998; for any two intervals Zou & Donner 2008):
    p - q - sqrt((p - low_p)^2 + (high_q - q)^2), and the same upwards.

    Raises:
        UserError: there are no seeds, or one without episodes.
    """
    p, q = rate_over_seeds(new), rate_over_seeds(stored)
    difference = p.rate - q.rate
    below = hypot(p.rate - p.low, q.high - q.rate)
    above = hypot(p.high - p.rate, q.rate - q.low)
    return Rate(difference, difference - below, difference + above)


def _check_counts(counts: Sequence[SeedCount]) -> None:
    if not counts:
        raise UserError("a success rate needs at least one training seed")
    for successes, episodes in counts:
        if not 0 <= successes <= episodes or episodes < 1:
            raise UserError(
                f"a success rate needs at least one episode, and no more successes "
                f"than episodes, not {successes} of {episodes}"
            )


def _resampled_means(counts: Sequence[SeedCount]) -> Array:
    """[RESAMPLES] mean rates; the same for the same counts."""
    rng = np.random.default_rng(0)
    successes, episodes = np.array(counts).T
    seeds = rng.integers(len(counts), size=(RESAMPLES, len(counts)))
    failures = episodes - successes
    return rng.beta(successes[seeds] + 0.5, failures[seeds] + 0.5).mean(axis=1)


def compare_seeds(new: Sequence[SeedCount], stored: Sequence[SeedCount]) -> Comparison:
    """Compare the success rates of two groups of training seeds.

    "worse" and "better" are one-sided t-tests at `LEVEL` each. "cannot tell": fewer
    than three seeds in both groups together, so that no spread is known. For the
    spread of Lift (mean 95.7 %, standard deviation 4.1 % between seeds of 100
    episodes) unchanged groups of 3 to 5 seeds are called worse in less than 5 % of
    comparisons; a drop of the mean to 85 % is detected in 70 % of comparisons of 3 with
    3 seeds, 93 % of 5 with 5.

    Raises:
        UserError: a seed has no episodes.
    """
    freedom = len(new) + len(stored) - 2
    if not (new and stored and freedom > 0):
        return "cannot tell"
    _check_counts([*new, *stored])
    from scipy.special import stdtrit  # takes 0.4 s to import

    critical = float(stdtrit(freedom, 1 - LEVEL))
    statistic = _t_statistic(new, stored)
    if abs(statistic) <= critical:
        return "agrees"
    return "worse" if statistic < 0 else "better"


def _t_statistic(new: Sequence[SeedCount], stored: Sequence[SeedCount]) -> float:
    """Student's t of the transformed rates, (mean of new - mean of stored) / error.

    The variance is pooled over both groups and at least the binomial variance of
    single episodes, 1 / (4 n + 2): three seeds that happen to agree do not show that
    seeds never differ.
    """
    groups = [_transformed(new), _transformed(stored)]
    squares = sum(((group - group.mean()) ** 2).sum() for group in groups)
    episodes = np.mean([count.episodes for count in (*new, *stored)])
    variance = max(squares / (len(new) + len(stored) - 2), 1 / (4 * episodes + 2))
    error = sqrt(variance * (1 / len(new) + 1 / len(stored)))
    return float(groups[0].mean() - groups[1].mean()) / error


def _transformed(counts: Sequence[SeedCount]) -> Array:
    """[S] arcsin sqrt((k + 3/8) / (n + 3/4)), of nearly constant variance and less
    skewed than the rate k / n (Anscombe 1948).
    """
    successes, episodes = np.array(counts, float).T
    return np.arcsin(np.sqrt((successes + 0.375) / (episodes + 0.75)))


def simulate_counts(
    mean: float, deviation: float, shape: tuple[int, int], episodes: int, seed: int
) -> Array:
    """Draw successes [comparisons, seeds] of training seeds that differ.

    The rate of a seed is Beta distributed, its episodes are binomial. `deviation` is
    the standard deviation between measured rates, the binomial part included.
    """
    rng = np.random.default_rng(seed)
    between = deviation**2 - mean * (1 - mean) / episodes
    total = mean * (1 - mean) / between - 1
    rates = rng.beta(mean * total, (1 - mean) * total, shape)
    return rng.binomial(episodes, rates)
