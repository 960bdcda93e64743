"""Aggregates of scores over training seeds and tasks, with bootstrap intervals.

The statistics of rliable (Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge
of the Statistical Precipice", arXiv 2108.13264): mean, interquartile mean, probability
of improvement, and stratified bootstrap intervals.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import nan

import numpy as np

Array = np.ndarray

Scores = Mapping[str, Array]
"""Task -> scores [S] of the training seeds; S may differ between tasks."""

RESAMPLES = 5_000
"""Bootstrap samples of an interval."""

TAIL = 0.025
"""Share of the resamples beyond each end of an interval."""

CUT = 0.25
"""Share of the scores that the interquartile mean leaves out at each end."""


@dataclass(frozen=True)
class Estimate:
    """A value and its 95 % interval over seeds; nan where a task has one seed only."""

    value: float
    low: float
    high: float


def mean(scores: Array) -> Array:
    """Mean over the last axis."""
    return np.asarray(scores.mean(axis=-1))


def interquartile_mean(scores: Array) -> Array:
    """Mean over the last axis without its lowest and highest quarter (section 4.3).

    Of n scores, floor(n / 4) are left out at each end.
    """
    count = scores.shape[-1]
    cut = int(CUT * count)
    return mean(np.sort(scores, axis=-1)[..., cut : count - cut])


def estimate(scores: Scores, statistic: Callable[[Array], Array]) -> Estimate:
    """A statistic of the scores of all tasks together, with its interval.

    Stratified bootstrap (section 4.1): each resample draws the seeds of each task with
    replacement. The interval is that of the percentiles.

    Args:
        scores: of one variant.
        statistic: `mean` or `interquartile_mean`.
    """
    value = statistic(np.concatenate([*scores.values()]))
    rng = np.random.default_rng(0)
    drawn = [_resample(s, rng) for s in scores.values()]
    return _with_interval(value, statistic(np.concatenate(drawn, axis=1)), scores)


def improvement(ours: Scores, other: Scores) -> Estimate:
    """Probability that a seed of one variant scores more than one of another.

    P = mean over tasks of (1 / (N M)) sum of [x > y] + [x = y] / 2 over the N M pairs
    of seeds (section 4.3, equation 2: the Mann-Whitney U statistic).

    Args:
        ours: scores of the variant.
        other: scores of the other one. Tasks that only one of both has are left out.
    """
    tasks = [task for task in ours if task in other]
    rng = np.random.default_rng(0)
    pairs = [(ours[task], other[task]) for task in tasks]
    value = np.mean([_wins(x, y) for x, y in pairs])
    resamples = [_wins(_resample(x, rng), _resample(y, rng)) for x, y in pairs]
    both = {f"{i}{j}": s for i, pair in enumerate(pairs) for j, s in enumerate(pair)}
    return _with_interval(value, np.mean(resamples, axis=0), both)


def _wins(x: Array, y: Array) -> Array:
    """Share of pairs [..., N, M] in which x is larger; ties count one half."""
    x, y = x[..., :, None], y[..., None, :]
    return np.asarray(((x > y) + 0.5 * (x == y)).mean(axis=(-2, -1)))


def _resample(scores: Array, rng: np.random.Generator) -> Array:
    """[RESAMPLES, S] scores drawn with replacement."""
    return scores[rng.integers(len(scores), size=(RESAMPLES, len(scores)))]


def _with_interval(value: Array, resampled: Array, scores: Scores) -> Estimate:
    if min(map(len, scores.values())) < 2:
        return Estimate(float(value), nan, nan)
    low, high = np.quantile(resampled, (TAIL, 1 - TAIL))
    return Estimate(float(value), float(low), float(high))
