"""Episodes: what a tracker says of scripted worlds, and which episodes are counted."""

from collections import Counter
from collections.abc import Sequence

import pytest
import torch
from tensordict import TensorDict
from toy import Points

from manip.evaluation.episodes import (
    HELD_STEPS,
    Episode,
    EpisodeTracker,
    run_episodes,
)
from manip.evaluation.report import summarise


def step(success: Sequence[bool], done: Sequence[bool], milestones=None) -> TensorDict:
    """The `next` entry of worlds that pay 0.5."""
    worlds = len(success)
    if milestones is None:
        milestones = [[flag, False] for flag in success]
    entries = {
        "success": torch.tensor(success).unsqueeze(-1),
        "done": torch.tensor(done).unsqueeze(-1),
        "reward": torch.full((worlds, 1), 0.5),
        "milestones": torch.tensor(milestones),
    }
    return TensorDict(entries, worlds)


def played(flags: str) -> Episode:
    """One world's episode: a character a step, `x` success and `.` none."""
    tracker, last = EpisodeTracker(1), len(flags) - 1
    for index, sign in enumerate(flags):
        ended = tracker.update(step([sign == "x"], [index == last]))
        assert bool(ended) == (index == last)
    return ended[0]


@pytest.mark.parametrize(
    ("flags", "once", "at_end", "held", "first"),
    [
        ("." * 12, False, False, False, None),
        ("." * 11 + "x", True, True, False, 12),
        ("x" + "." * 11, True, False, False, 1),
        ("..xx" + "." * 8, True, False, False, 3),
        ("." * 3 + "x" * (HELD_STEPS - 1), True, True, False, 4),
        ("." * 3 + "x" * HELD_STEPS, True, True, True, 4),
        ("xxx." + "x" * HELD_STEPS, True, True, True, 1),
        ("x" * HELD_STEPS + ".x", True, True, False, 1),
        ("x" * (HELD_STEPS - 1), True, True, False, 1),
    ],
)
def test_success_once_at_end_and_held(flags, once, at_end, held, first) -> None:
    episode = played(flags)
    assert episode.success_once == once
    assert episode.success_at_end == at_end
    assert episode.success_held == held
    assert episode.first_success == first
    assert episode.steps == len(flags)
    assert episode.total_reward == 0.5 * len(flags)


def test_stages_are_those_ever_milestones() -> None:
    tracker = EpisodeTracker(2)
    for milestones in (
        [[True, False], [False, False]],
        [[False, False], [False, True]],
    ):
        assert not tracker.update(step([False] * 2, [False] * 2, milestones))
    final = step([False] * 2, [True] * 2, [[False, False], [False, True]])
    reached = [episode.milestones for episode in tracker.update(final)]
    assert reached == [(True, False), (False, True)]


def test_nothing_is_carried_over_to_a_worlds_next_episode() -> None:
    tracker = EpisodeTracker(2)
    tracker.update(step([True, True], [False, False], [[True, True]] * 2))
    (first,) = tracker.update(step([True, True], [True, False], [[True, True]] * 2))
    assert (first.env_id, first.steps, first.first_success) == (0, 2, 1)
    none = [[False, False]] * 2
    fresh, long = tracker.update(step([False, True], [True, True], none))
    assert fresh == Episode(0, 1, 0.5, False, False, False, None, (False, False))
    assert long == Episode(1, 3, 1.5, True, True, False, 1, (True, True))


def test_a_tracker_that_is_saved_goes_on_as_it_was() -> None:
    tracker, other = EpisodeTracker(1), EpisodeTracker(1)
    for _ in range(HELD_STEPS - 1):
        tracker.update(step([True], [False]))
    other.load_state(tracker.save_state())
    tracker.update(step([False], [True]))
    (episode,) = other.update(step([True], [True]))
    assert episode.success_held
    assert (episode.steps, episode.first_success) == (HELD_STEPS, 1)


def still(observation: torch.Tensor) -> torch.Tensor:
    return torch.zeros_like(observation)


@pytest.mark.parametrize("each", [1, 2, 5])
def test_every_world_gives_the_same_number_of_episodes(each: int) -> None:
    """World 0 is over ten times as often as the others and counts no more for it."""
    env = Points([2, 20, 20, 20])
    found = run_episodes(env, still, 4 * each)
    assert Counter(episode.env_id for episode in found) == dict.fromkeys(range(4), each)
    assert all(e.steps == (2 if e.env_id == 0 else 20) for e in found)


def test_short_episodes_do_not_bias_the_mean() -> None:
    found = run_episodes(Points([2, 50, 50, 50], start=0.0), still, 4)
    mean = sum(episode.total_reward for episode in found) / len(found)
    assert mean == (2 + 3 * 50) / 4


def test_a_split_that_is_not_even_is_refused() -> None:
    with pytest.raises(ValueError, match="10 episodes cannot be shared evenly by 4 environments"):
        run_episodes(Points([3] * 4), still, 10)


def test_the_policy_decides_and_the_watcher_sees_each_state_before_a_step() -> None:
    seen: list[float] = []
    (episode,) = run_episodes(
        Points([4], start=0.8),
        lambda observation: torch.full_like(observation, -1.0),
        1,
        callback=lambda state: seen.append(state["observation"].item()),
    )
    assert seen == pytest.approx([0.8, 0.6, 0.4, 0.2], abs=1e-6)
    assert episode.total_reward == pytest.approx(0.4 + 0.6 + 0.8 + 1.0)
    assert (episode.success_at_end, episode.first_success, episode.milestones) == (
        True,
        4,
        (True,),
    )


def test_summary_gives_rates_means_and_the_median_of_first_successes() -> None:
    episodes = [
        Episode(0, 9, 1.0, True, True, True, 3, (True, True)),
        Episode(1, 9, 2.0, True, False, False, 7, (True, False)),
        Episode(2, 9, 6.0, False, False, False, None, (True, False)),
        Episode(3, 9, 3.0, False, False, False, None, (False, False)),
    ]
    found = summarise(episodes, ("near", "there"))
    rates = {kind: rate.rate for kind, rate in found["success"].items()}
    assert rates == {"success_once": 0.5, "success_at_end": 0.25, "success_held": 0.25}
    assert found["return_mean"] == 3.0
    assert found["milestones"] == {"near": 0.75, "there": 0.25}
    assert found["first_success_median"] == 5.0
    assert summarise(episodes[2:], ("near", "there"))["first_success_median"] is None
