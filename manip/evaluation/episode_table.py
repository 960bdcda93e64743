"""The episodes of an evaluation as a table, one row each: episodes.csv."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from manip.envs.task import Task
from manip.evaluation.episodes import Episode
from manip.evaluation.motion import Motion, share_of_limits
from manip.io.csv_text import csv_text


def episode_rows(episodes: Sequence[Episode], task: Task) -> list[dict[str, Any]]:
    """A row for each episode of a task, in the order of their numbers.

    Columns: index; steps; return; success_once, success_at_end, success_held, 0 or 1;
    first_success, a step from 1; milestone/<name>, the first step of the milestone;
    reward/<term>, the sum of weight * term; those of `Motion.columns` where the motion
    was recorded. Steps that did not occur are empty.
    """
    terms = tuple(task.weights["shaped" if "shaped" in task.weights else "stock"])
    return [
        _row(episode, task.milestone_names, terms)
        for episode in sorted(episodes, key=lambda episode: episode.index)
    ]


def episodes_csv(rows: Sequence[dict[str, Any]]) -> str:
    """Rows of `episode_rows` as CSV."""
    return csv_text(list(dict.fromkeys(name for row in rows for name in row)), rows)


def motion_summary(episodes: Sequence[Episode], arm: str) -> dict[str, float] | None:
    """Medians over the episodes; None if no motion was recorded.

    speed, torque, jerk: largest share of the arm's limits (see `share_of_limits`);
    action_change, hand_tilt [rad], self_contact: as in `Motion`.
    """
    motions = [e.details.motion for e in episodes if e.details and e.details.motion]
    rows = [_shares(motion, arm) for motion in motions]
    names = rows[0] if rows else ()
    return {n: float(np.median([row[n] for row in rows])) for n in names} or None


def _shares(motion: Motion, arm: str) -> dict[str, float]:
    single = ("action_change", "hand_tilt", "self_contact")
    return share_of_limits(motion, arm) | {n: getattr(motion, n) for n in single}


def _row(
    episode: Episode, milestones: Sequence[str], terms: Sequence[str]
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "index": episode.index,
        "steps": episode.steps,
        "return": episode.total_reward,
        "success_once": int(episode.success_once),
        "success_at_end": int(episode.success_at_end),
        "success_held": int(episode.success_held),
        "first_success": episode.first_success,
    }
    details = episode.details
    if details is None:
        return row
    steps = zip(milestones, details.milestone_steps, strict=True)
    row |= {f"milestone/{name}": step for name, step in steps}
    sums = zip(terms, details.reward_terms, strict=True)
    row |= {f"reward/{name}": total for name, total in sums}
    return row | (details.motion.columns() if details.motion else {})
