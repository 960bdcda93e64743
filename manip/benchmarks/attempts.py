"""Attempts at a task: how long until its success is held in stock robosuite."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite
from statistics import median
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from manip.evaluation.episodes import Policy
from manip.evaluation.runners import EpisodeSettings, evaluate_policy
from manip.evaluation.statistics import Rate, success_rate
from manip.robot_config import RobotConfig

GOAL = 0.95
"""Rate of held success at which a task counts as learned."""


@dataclass(frozen=True)
class Attempt:
    """What one seed came to.

    Attributes:
        seconds: of wall time until `held` was reached, evaluation not counted.
        env_steps: control steps until then.
        success_held: rate of success held at the end of an episode, in stock robosuite.
    """

    who: str
    seed: int
    seconds: float
    env_steps: int
    success_held: Rate

    @property
    def reached(self) -> bool:
        """Whether the task counts as learned."""
        return self.success_held.rate >= GOAL

    @property
    def time(self) -> float:
        """Seconds to the goal; infinite if it was missed."""
        return self.seconds if self.reached else inf

    def plain(self) -> dict[str, Any]:
        """As JSON holds it: no time where the goal was missed."""
        held = {
            "rate": self.success_held.rate,
            "low": self.success_held.low,
            "high": self.success_held.high,
        }
        fields = {"who": self.who, "seed": self.seed, "env_steps": self.env_steps}
        times = {"seconds": self.seconds, "seconds_to_goal": finite(self.time)}
        return {**fields, **times, "success_held": held}


def finite(value: float) -> float | None:
    """The value, or None where it is infinite."""
    return value if isfinite(value) else None


def median_time(attempts: Sequence[Attempt]) -> float:
    """Median seconds to the goal, failures counting as infinite."""
    return median(attempt.time for attempt in attempts)


def figures(mine: Sequence[Attempt], peers: Sequence[Attempt]) -> dict[str, Any]:
    """Medians of both, and how many times longer the peer takes.

    A peer that never got there took at least as long as it was given.
    """
    found = {
        "seconds_to_held": finite(median_time(mine)),
        "env_steps_to_held": _steps(mine),
        "seeds_reached": sum(attempt.reached for attempt in mine),
        "seeds": len(mine),
    }
    if peers:
        least = median(attempt.seconds for attempt in peers)
        found["sb3_seconds_to_held"] = finite(median_time(peers))
        found["sb3_env_steps_to_held"] = _steps(peers)
        found["sb3_times_longer_at_least"] = least / median_time(mine)
    return found


def _steps(attempts: Sequence[Attempt]) -> float | None:
    taken = [a.env_steps if a.reached else inf for a in attempts]
    return finite(median(taken))


def held_in_stock(task: str, policy: Policy, episodes: int, robot: RobotConfig) -> Rate:
    """Rate of held success in stock robosuite, episodes 0, 1, ...; shows progress."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        running = bar.add_task("stock robosuite", total=episodes)
        settings = EpisodeSettings(task, robot, episodes=episodes)
        found = evaluate_policy(policy, settings, lambda n: bar.advance(running, n))
    return success_rate([episode.success_held for episode in found])


def table(task: str, attempts: Sequence[Attempt]) -> Table:
    """A row a seed."""
    shown = Table(title=f"{task}: wall time to {GOAL:.0%} held in stock robosuite")
    shown.add_column("who")
    for column in (
        "seed",
        "seconds",
        "env steps",
        "success_held",
        "95 % interval",
        "goal",
    ):
        shown.add_column(column, justify="right")
    for attempt in attempts:
        held = attempt.success_held
        shown.add_row(
            attempt.who,
            str(attempt.seed),
            f"{attempt.seconds:,.1f}",
            f"{attempt.env_steps:,}",
            f"{held.rate:.1%}",
            f"{held.low:.0%} - {held.high:.0%}",
            "reached" if attempt.reached else "missed",
        )
    return shown


def verdict(attempt: Attempt) -> str:
    """One line on a run of a peer."""
    if attempt.reached:
        return f"{attempt.who}: {attempt.seconds:,.0f} s, {attempt.env_steps:,} steps"
    return (
        f"{attempt.who}: not within {attempt.seconds / 60:.0f} min: "
        f"{attempt.success_held.rate:.0%} held after {attempt.env_steps:,} steps"
    )
