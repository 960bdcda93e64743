"""Noise and bias of gradient estimates, with bootstrap intervals and a noise floor.

A sample is a matrix g [M, P]: one gradient per rollout. With the sample mean m and the
trace t of the sample covariance, E |m|^2 = |E g|^2 + E t / M, so

    |m|^2 - t / M    estimates |E g|^2 without bias.

The bootstrap (Efron 1979) draws M rollouts with replacement. Its means vary around m,
not around E g, which adds another t / M to the squared length. It is subtracted too.

All of these follow from the Gram matrix G = g g^T and from the numbers c_i of times
that rollout i is drawn: |m|^2 = c^T G c / M^2.
"""

from dataclasses import dataclass
from math import nan

import torch
from torch import Tensor

RESAMPLES = 1000
"""Bootstrap resamples of an interval."""

LEVEL = 0.95
"""Of intervals and of the noise floor."""


@dataclass(frozen=True)
class Interval:
    """An estimate and its 95 % bootstrap interval; nan: not bounded by the rollouts."""

    value: float
    low: float
    high: float


MISSING = Interval(nan, nan, nan)
"""The estimate if the gradient of reference is not distinguishable from zero."""


@dataclass(frozen=True)
class Comparison:
    """A sample of gradients, relative to the squared mean of a reference sample.

    Attributes:
        noise: trace of the sample's covariance.
        bias: squared length of the difference of both means.
        floor: 95 % quantile that `bias` has by chance if both means are equal.
    """

    noise: Interval
    bias: Interval
    floor: float


def compare(sample: Tensor, reference: Tensor) -> Comparison:
    """Compare gradients [M, P] with those of a reference, from the same rollouts."""
    signal = squared_mean(reference)
    if signal <= 0:
        return Comparison(MISSING, MISSING, nan)
    resamples = _resamples(len(sample))
    signals = _resampled_squared_mean(reference, resamples)
    traces = _moments(_gram(sample), resamples)[1]
    difference = sample - reference
    biases = _resampled_squared_mean(difference, resamples).clamp_min(0.0)
    noise = (sample.double().var(0).sum() / signal).item()
    bias = max(0.0, squared_mean(difference)) / signal
    return Comparison(
        _interval(noise, traces, signals),
        _interval(bias, biases, signals),
        _floor(difference, resamples) / signal,
    )


def squared_mean(sample: Tensor) -> float:
    """Estimate |E g|^2 from gradients [M, P] without bias; may be negative."""
    once = torch.ones(1, len(sample), dtype=torch.float64)
    squared, trace = _moments(_gram(sample), once)
    return (squared - trace / len(sample)).item()


def _resampled_squared_mean(sample: Tensor, resamples: Tensor) -> Tensor:
    squared, trace = _moments(_gram(sample), resamples)
    return squared - 2 * trace / len(sample)


def _floor(difference: Tensor, resamples: Tensor) -> float:
    """The quantile of the estimate for differences whose mean is set to zero."""
    centred = difference - difference.mean(0)
    squared, trace = _moments(_gram(centred), resamples)
    chance = squared - trace / len(difference)
    return max(0.0, chance.quantile(LEVEL).item())


def _resamples(rollouts: int) -> Tensor:
    """How often each rollout is drawn: [B, M]; the same in every call."""
    draw = torch.Generator().manual_seed(0)
    drawn = torch.randint(rollouts, (RESAMPLES, rollouts), generator=draw)
    times = torch.zeros(RESAMPLES, rollouts, dtype=torch.float64)
    return times.scatter_add_(1, drawn, torch.ones_like(times))


def _gram(sample: Tensor) -> Tensor:
    double = sample.double()
    return double @ double.T


def _moments(gram: Tensor, times: Tensor) -> tuple[Tensor, Tensor]:
    """Squared length of the mean and trace of the covariance, [B] each.

    Args:
        gram: products of the M gradients [M, M].
        times: how often each gradient is drawn [B, M].
    """
    count = len(gram)
    squared = (times @ gram * times).sum(1) / count**2
    total = times @ gram.diagonal()
    return squared, (total - count * squared) / (count - 1)


def _interval(value: float, numerators: Tensor, denominators: Tensor) -> Interval:
    """Percentile interval of a ratio; without an upper bound where signals vanish."""
    ratios = torch.where(denominators > 0, numerators / denominators, torch.inf)
    tail = (1 - LEVEL) / 2
    low, high = (_quantile(ratios, share) for share in (tail, 1 - tail))
    return Interval(value, low, high)


def _quantile(values: Tensor, share: float) -> float:
    """The nearest-rank quantile; nan where it is infinite."""
    ranked = values.sort().values
    quantile = ranked[round(share * (len(values) - 1))].item()
    return quantile if quantile < torch.inf else nan
