"""Episodes: what a tracker reports of given steps, and which episodes count."""

from collections import Counter
from collections.abc import Mapping, Sequence
from io import StringIO

import pytest
import torch
from rich.console import Console
from tensordict import TensorDict
from toy import Points

from manip.evaluation.episodes import (
    HELD_STEPS,
    Episode,
    EpisodeTracker,
    run_episodes,
)
from manip.evaluation.report import Evaluation, summarise, table


def step(success: Sequence[bool], done: Sequence[bool], milestones=None) -> TensorDict:
    """The `next` entry of environments whose reward is 0.5."""
    num_envs = len(success)
    if milestones is None:
        milestones = [[flag, False] for flag in success]
    entries = {
        "success": torch.tensor(success).unsqueeze(-1),
        "done": torch.tensor(done).unsqueeze(-1),
        "reward": torch.full((num_envs, 1), 0.5),
        "milestones": torch.tensor(milestones),
    }
    return TensorDict(entries, num_envs)


def tracked(flags: str) -> Episode:
    """The episode of these steps: `x` is success, `.` is none."""
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
    episode = tracked(flags)
    assert episode.success_once == once
    assert episode.success_at_end == at_end
    assert episode.success_held == held
    assert episode.first_success == first
    assert episode.steps == len(flags)
    assert episode.total_reward == 0.5 * len(flags)


def test_a_milestone_counts_if_it_was_true_once() -> None:
    tracker = EpisodeTracker(2)
    for milestones in (
        [[True, False], [False, False]],
        [[False, False], [False, True]],
    ):
        assert not tracker.update(step([False] * 2, [False] * 2, milestones))
    final = step([False] * 2, [True] * 2, [[False, False], [False, True]])
    milestones = [episode.milestones for episode in tracker.update(final)]
    assert milestones == [(True, False), (False, True)]


def test_an_episode_starts_with_empty_counters() -> None:
    tracker = EpisodeTracker(2)
    tracker.update(step([True, True], [False, False], [[True, True]] * 2))
    (first,) = tracker.update(step([True, True], [True, False], [[True, True]] * 2))
    assert (first.env_id, first.steps, first.first_success) == (0, 2, 1)
    none = [[False, False]] * 2
    fresh, long = tracker.update(step([False, True], [True, True], none))
    assert fresh == Episode(0, 1, 0.5, False, False, False, None, (False, False))
    assert long == Episode(1, 3, 1.5, True, True, False, 1, (True, True))


def test_a_restored_tracker_continues() -> None:
    tracker, other = EpisodeTracker(1), EpisodeTracker(1)
    for _ in range(HELD_STEPS - 1):
        tracker.update(step([True], [False]))
    other.load_state(tracker.save_state())
    tracker.update(step([False], [True]))
    (episode,) = other.update(step([True], [True]))
    assert episode.success_held
    assert (episode.steps, episode.first_success) == (HELD_STEPS, 1)


def test_a_tracker_of_other_environments_is_refused() -> None:
    """One saved row would be broadcast to all environments."""
    saved = EpisodeTracker(1)
    saved.update(step([True], [False]))
    with pytest.raises(ValueError, match="1 environments"):
        EpisodeTracker(3).load_state(saved.save_state())


def still(parts: Mapping[str, torch.Tensor]) -> torch.Tensor:
    return torch.zeros_like(parts["x"])


@pytest.mark.parametrize("each", [1, 2, 5])
def test_every_environment_runs_the_same_number_of_episodes(each: int) -> None:
    """Environment 0 has episodes a tenth as long, and counts no more for it."""
    env = Points([2, 20, 20, 20])
    episodes = run_episodes(env, still, 4 * each)
    assert Counter(episode.env_id for episode in episodes) == dict.fromkeys(
        range(4), each
    )
    assert all(e.steps == (2 if e.env_id == 0 else 20) for e in episodes)


def test_short_episodes_do_not_bias_the_mean() -> None:
    episodes = run_episodes(Points([2, 50, 50, 50], start=0.0), still, 4)
    mean = sum(episode.total_reward for episode in episodes) / len(episodes)
    assert mean == (2 + 3 * 50) / 4


def test_episodes_that_cannot_be_shared_evenly_are_refused() -> None:
    with pytest.raises(
        ValueError, match="10 episodes cannot be shared evenly by 4 environments"
    ):
        run_episodes(Points([3] * 4), still, 10)


def test_the_policy_acts_and_the_callback_gets_each_state_before_its_step() -> None:
    states: list[float] = []
    (episode,) = run_episodes(
        Points([4], start=0.8),
        lambda parts: torch.full_like(parts["x"], -1.0),
        1,
        callback=lambda state: states.append(state["observation"].item()),
    )
    assert states == pytest.approx([0.8, 0.6, 0.4, 0.2], abs=1e-6)
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
    summary = summarise(episodes, ("near", "there"))
    rates = {kind: rate.rate for kind, rate in summary["success"].items()}
    assert rates == {"success_once": 0.5, "success_at_end": 0.25, "success_held": 0.25}
    assert summary["return_mean"] == 3.0
    assert summary["milestones"] == {"near": 0.75, "there": 0.25}
    assert summary["first_success_median"] == 5.0
    assert summarise(episodes[2:], ("near", "there"))["first_success_median"] is None


def test_the_table_shows_odd_text_as_it_is() -> None:
    """Neither as markup of rich, which may fail, nor as commands to the terminal."""
    text = "[red]ppo[/red] [/nonsense] \x1b[2J\n"
    episode = Episode(0, 9, 1.0, True, True, True, 3, (True,))
    result = Evaluation(
        *("Lift", "Panda", text, "stock", "exact"),
        **{"episodes": 1, "seed": 0, "purpose": "evaluation", "env_steps_trained": 9},
        **summarise([episode], [text]),
        **{"seconds": 1.0, "versions": {}},
    )
    shown = StringIO()
    Console(file=shown, width=200).print(table(result))
    assert shown.getvalue().count(r"[red]ppo[/red] [/nonsense] \x1b[2J\n") == 2
    assert "\x1b" not in shown.getvalue()
