"""Aggregates over seeds and tasks: their values, and what their intervals cover."""

from math import isnan

import numpy as np
import pytest
from scipy.stats import mannwhitneyu, trim_mean

from manip.evaluation.aggregates import (
    estimate,
    improvement,
    interquartile_mean,
    mean,
)

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("count", range(1, 14))
def test_the_interquartile_mean_is_that_of_scipy(count: int) -> None:
    scores = RNG.normal(size=(5, count))
    expected = trim_mean(scores, 0.25, axis=1)
    assert interquartile_mean(scores) == pytest.approx(expected)


def test_the_probability_of_improvement_is_the_u_statistic() -> None:
    """Mean over tasks of U / (N M), with ties."""
    tasks = {"Lift": (5, 7), "Reach": (4, 3)}
    pairs = {t: [RNG.integers(4, size=n) / 4 for n in c] for t, c in tasks.items()}
    ours, other = ({t: pair[i] for t, pair in pairs.items()} for i in (0, 1))
    expected = [
        mannwhitneyu(x, y).statistic / (len(x) * len(y)) for x, y in pairs.values()
    ]
    assert improvement(ours, other).value == pytest.approx(np.mean(expected))
    assert improvement(other, ours).value == pytest.approx(1 - np.mean(expected))


def test_tasks_of_one_variant_only_are_left_out() -> None:
    ours = {"Lift": np.array([1.0, 1.0]), "Door": np.array([0.0, 0.0])}
    result = improvement(ours, {"Lift": np.array([0.0, 0.5])})
    assert (result.value, result.low, result.high) == (1, 1, 1)


def test_seeds_are_resampled_within_each_task() -> None:
    """Tasks that differ, with seeds that agree, leave nothing uncertain."""
    scores = {"Lift": np.full(3, 0.2), "Reach": np.full(3, 0.8)}
    result = estimate(scores, mean)
    assert (result.value, result.low, result.high) == pytest.approx((0.5, 0.5, 0.5))


def test_intervals_cover_the_mean_of_other_seeds() -> None:
    """20 normal seeds: the percentile bootstrap covers a little less than 95 %."""
    covered = 0
    for _ in range(100):
        result = estimate({"Lift": RNG.normal(size=20)}, mean)
        covered += result.low <= 0 <= result.high
    assert 86 <= covered <= 99


def test_one_seed_has_no_interval() -> None:
    scores = {"Lift": np.array([0.5]), "Reach": np.array([0.1, 0.3])}
    for result in (estimate(scores, interquartile_mean), improvement(scores, scores)):
        assert isnan(result.low)
        assert isnan(result.high)
    assert estimate(scores, mean).value == pytest.approx(0.3)
