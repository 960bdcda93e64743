"""When rows are logged and evaluations take place, by the steps of a run alone."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from manip.evaluation.episodes import Episode
from manip.training.experience import Experience, by_time
from manip.training.schedule import curve_due, has_curve, next_choice, row_due, rows_in

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
    within = rows_in(length, steps) - 1
    assert len(rows) + within * (steps // length) >= 100


def test_the_episodes_of_a_rollout_are_split_by_the_step_in_which_they_ended() -> None:
    done = torch.zeros(2, 5, 1, dtype=torch.bool)
    for env_id, step in ((1, 0), (0, 2), (1, 2), (0, 4)):
        done[env_id, step] = True
    episodes = [
        episode(env_id, steps) for env_id, steps in ((1, 1), (0, 3), (1, 3), (0, 5))
    ]
    batch = TensorDict({"next": {"done": done}}, [2, 5])
    rollout = Experience(batch, 10, episodes, [0.0])
    assert by_time(rollout, 2) == [(6, episodes[:3]), (10, episodes[3:])]
    assert [steps for steps, _ in by_time(rollout, 99)] == [2, 4, 6, 8, 10]
    assert by_time(rollout, 1) == [(10, episodes)]
    unordered = replace(rollout, episodes=episodes[::-1])
    without = replace(rollout, batch=TensorDict({}, [2, 5]))
    assert by_time(unordered, 2) == [(10, episodes[::-1])]
    assert by_time(without, 2) == [(10, episodes)]


def episode(env_id: int, steps: int) -> Episode:
    return Episode(env_id, steps, 0.0, False, False, False, None, ())
