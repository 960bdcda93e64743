"""Success rates: shares, and Wilson's interval as SciPy has it."""

import pytest
from scipy.stats import binomtest

from manip.evaluation.statistics import success_rate

Z = 1.959963984540054
"""The normal distribution's 97.5 % quantile."""


@pytest.mark.parametrize(
    ("count", "total"),
    [(0, 1), (1, 1), (0, 100), (100, 100), (1, 2), (3, 7), (95, 100), (1, 3000)],
)
def test_interval_is_wilsons(count: int, total: int) -> None:
    rate = success_rate([True] * count + [False] * (total - count))
    interval = binomtest(count, total).proportion_ci(method="wilson")
    assert rate.rate == count / total
    assert rate.low == pytest.approx(interval.low, abs=1e-9)
    assert rate.high == pytest.approx(interval.high, abs=1e-9)
    assert 0 <= rate.low <= rate.rate <= rate.high <= 1


def test_no_success_and_all_successes_are_not_certainties() -> None:
    none, all_of_them = success_rate([False] * 50), success_rate([True] * 50)
    assert (none.low, all_of_them.high) == (0, 1)
    assert none.high == pytest.approx(1 - all_of_them.low)
    assert none.high == pytest.approx(Z**2 / (50 + Z**2))


def test_order_does_not_count_and_more_episodes_narrow() -> None:
    few = success_rate([True, False, True, False])
    assert few == success_rate([False, False, True, True])
    many = success_rate([True, False] * 200)
    assert few.low < many.low < many.rate < many.high < few.high
