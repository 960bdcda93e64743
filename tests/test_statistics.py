"""Success rates: Wilson's interval as SciPy has it, and intervals over seeds."""

import numpy as np
import pytest
from scipy.stats import binomtest

from manip.errors import UserError
from manip.evaluation.statistics import (
    SeedCount,
    compare_seeds,
    rate_over_seeds,
    simulate_counts,
    success_rate,
    wilson_rate,
)

Z = 1.959963984540054
"""97.5 % quantile of the normal distribution."""

LIFT = (0.957, 0.041)
"""Measured on 13 training runs of Lift: mean and standard deviation of rates."""

EPISODES = 100


@pytest.mark.parametrize(
    ("count", "total"),
    [(0, 1), (1, 1), (0, 100), (100, 100), (1, 2), (3, 7), (95, 100), (1, 3000)],
)
def test_interval_is_wilsons(count: int, total: int) -> None:
    rate = success_rate([True] * count + [False] * (total - count))
    interval = binomtest(count, total).proportion_ci(method="wilson")
    assert rate == wilson_rate(count, total)
    assert rate.rate == count / total
    assert rate.low == pytest.approx(interval.low, abs=1e-9)
    assert rate.high == pytest.approx(interval.high, abs=1e-9)
    assert 0 <= rate.low <= rate.rate <= rate.high <= 1


def test_no_success_and_all_successes_are_not_certainties() -> None:
    none, every = success_rate([False] * 50), success_rate([True] * 50)
    assert (none.low, every.high) == (0, 1)
    assert none.high == pytest.approx(1 - every.low)
    assert none.high == pytest.approx(Z**2 / (50 + Z**2))


def test_order_does_not_count_and_more_episodes_narrow() -> None:
    few = success_rate([True, False, True, False])
    assert few == success_rate([False, False, True, True])
    many = success_rate([True, False] * 200)
    assert few.low < many.low < many.rate < many.high < few.high


def counts(*successes: int) -> list[SeedCount]:
    return [SeedCount(int(k), EPISODES) for k in successes]


def test_one_seed_has_the_interval_of_its_episodes() -> None:
    assert rate_over_seeds(counts(93)) == wilson_rate(93, 100)


def test_the_interval_over_seeds_contains_the_spread_between_seeds() -> None:
    alike, spread = (
        rate_over_seeds(counts(90, 90, 90)),
        rate_over_seeds(counts(80, 90, 100)),
    )
    assert alike.rate == pytest.approx(spread.rate) == pytest.approx(0.9)
    assert spread.high - spread.low > 1.5 * (alike.high - alike.low)
    certain = rate_over_seeds(counts(100, 100, 100))
    assert certain.low < 1 == certain.high
    assert rate_over_seeds(counts(80, 90, 100)) == spread


@pytest.mark.slow
@pytest.mark.parametrize(("seeds", "least"), [(3, 0.90), (5, 0.92)])
def test_the_interval_over_seeds_covers_the_mean(seeds: int, least: float) -> None:
    drawn = simulate_counts(*LIFT, (400, seeds), EPISODES, seed=1)
    rates = [rate_over_seeds(counts(*row)) for row in drawn]
    covered = np.mean([rate.low <= LIFT[0] <= rate.high for rate in rates])
    assert covered >= least


def verdicts(mean: float, new_seeds: int, stored_seeds: int, n: int) -> list[str]:
    """Comparisons of new runs of this mean with stored runs of Lift's."""
    new = simulate_counts(mean, LIFT[1], (n, new_seeds), EPISODES, seed=2)
    stored = simulate_counts(*LIFT, (n, stored_seeds), EPISODES, seed=3)
    return [
        compare_seeds(counts(*a), counts(*b)) for a, b in zip(new, stored, strict=True)
    ]


GROUPS = [(3, 1), (3, 3), (3, 5), (5, 3), (5, 5), (3, 13)]


@pytest.mark.parametrize(("new", "stored"), GROUPS)
def test_unchanged_lift_is_called_worse_in_at_most_5_percent(new, stored) -> None:
    results = verdicts(LIFT[0], new, stored, n=4000)
    assert results.count("worse") / 4000 <= 0.05
    assert results.count("better") / 4000 <= 0.05


@pytest.mark.parametrize(
    ("new", "stored", "power"),
    [(3, 1, 0.3), (3, 3, 0.68), (3, 5, 0.8), (5, 5, 0.9)],
)
def test_a_drop_to_85_percent_is_found(new, stored, power) -> None:
    results = verdicts(0.85, new, stored, n=2000)
    assert results.count("worse") / 2000 >= power


def test_a_comparison_needs_three_seeds_and_goes_both_ways() -> None:
    assert compare_seeds(counts(0), counts(100)) == "cannot tell"
    assert compare_seeds(counts(50, 50, 50), []) == "cannot tell"
    assert compare_seeds(counts(60, 62, 61), counts(97, 99, 98)) == "worse"
    assert compare_seeds(counts(97, 99, 98), counts(60, 62, 61)) == "better"
    assert compare_seeds(counts(98, 98, 98), counts(98, 98, 98)) == "agrees"


def test_seeds_that_agree_by_chance_are_no_proof() -> None:
    """Without a least variance, 98 98 98 against 99 99 99 would be certain."""
    assert compare_seeds(counts(98, 98, 98), counts(99, 99, 99)) == "agrees"


@pytest.mark.parametrize(("successes", "episodes"), [(0, 0), (3, 2), (-1, 5), (0, -1)])
def test_counts_that_cannot_be_are_refused(successes: int, episodes: int) -> None:
    count = SeedCount(successes, episodes)
    with pytest.raises(UserError, match="a success rate needs at least one episode"):
        wilson_rate(successes, episodes)
    with pytest.raises(UserError, match="a success rate needs at least one episode"):
        rate_over_seeds([count, count])
    with pytest.raises(UserError, match="a success rate needs at least one episode"):
        compare_seeds([count] * 3, [count] * 3)


def test_a_rate_of_no_seeds_is_refused() -> None:
    with pytest.raises(UserError, match="at least one training seed"):
        rate_over_seeds([])
