"""When rows are logged and evaluations take place, by the steps of a run alone."""

import pytest

from manip.training.schedule import curve_due, has_curve, next_choice, row_due

RUNS = [
    (8_000, 64, 8_000),
    (42_000, 64, 14_000),
    (240_000, 32, 60_000),
    (400_000, 4096, 50_000),
    (160_000, 80, 80_000),
    (100_003, 7, 9_999),
    (512, 64, 192),
]
"""Steps of a run, of a rollout, and between evaluations that choose the policy."""


def rollouts(steps: int, length: int) -> list[tuple[int, int]]:
    """Steps before and after each rollout."""
    return [(before, before + length) for before in range(0, steps, length)]


@pytest.mark.parametrize(("steps", "length", "every"), RUNS)
def test_each_tenth_of_a_run_has_an_evaluation(steps, length, every) -> None:
    choosing, light = [], []
    for before, now in rollouts(steps, length):
        if now >= next_choice(before, every, steps):
            choosing.append(now)
        elif curve_due(before, now, every, steps):
            light.append(now)
    expected = [-(-due // length) * length for due in range(every, steps, every)]
    assert choosing == [*expected, -(-steps // length) * length]
    if length <= steps // 10:
        assert 10 <= len(choosing) + len(light) <= max(10, len(choosing)) + 1
    assert bool(light) == has_curve(every, steps)


@pytest.mark.parametrize(("steps", "length", "every"), RUNS)
def test_rows_are_all_rollouts_or_about_a_thousand(steps, length, every) -> None:
    rows = [
        now for before, now in rollouts(steps, length) if row_due(before, now, steps)
    ]
    assert min(steps // length, 900) <= len(rows) <= min(-(-steps // length), 1_010)
