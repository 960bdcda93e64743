"""Training runs that are timed until the task is learned, and their statistics."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
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
"""Rate of success_held at which a task counts as learned."""

COLUMNS = ("seed", "seconds", "env steps", "success_held", "95 % interval", "goal")


@dataclass(frozen=True)
class TimedRun:
    """A training run with one seed.

    Attributes:
        learner: library and algorithm.
        seed: of the run.
        seconds: wall time of training, without evaluations.
        env_steps: control steps of training.
        success_held: of the final policy, in stock robosuite.
    """

    learner: str
    seed: int
    seconds: float
    env_steps: int
    success_held: Rate

    @property
    def reached(self) -> bool:
        """Whether the task counts as learned."""
        return self.success_held.rate >= GOAL

    @property
    def seconds_to_goal(self) -> float:
        """Seconds until the task was learned; infinite if it was not."""
        return self.seconds if self.reached else inf

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; seconds_to_goal is None if the goal was missed."""
        return asdict(self) | {"seconds_to_goal": finite(self.seconds_to_goal)}


def finite(value: float) -> float | None:
    """The value, or None if it is infinite."""
    return value if isfinite(value) else None


def median_time(runs: Sequence[TimedRun]) -> float:
    """Median seconds to the goal; runs that missed it count as infinite."""
    return median(run.seconds_to_goal for run in runs)


def figures(manip: Sequence[TimedRun], sb3: Sequence[TimedRun]) -> dict[str, Any]:
    """Medians of both libraries, and how many times longer Stable-Baselines3 takes.

    The time of a run that missed the goal is a lower bound of the time it needs.
    """
    values = {
        "seconds_to_held": finite(median_time(manip)),
        "env_steps_to_held": _steps(manip),
        "seeds_reached": sum(run.reached for run in manip),
        "seeds": len(manip),
    }
    if sb3:
        lower_bound = median(run.seconds for run in sb3)
        values["sb3_seconds_to_held"] = finite(median_time(sb3))
        values["sb3_env_steps_to_held"] = _steps(sb3)
        values["sb3_times_longer_at_least"] = lower_bound / median_time(manip)
    return values


def _steps(runs: Sequence[TimedRun]) -> float | None:
    return finite(median(run.env_steps if run.reached else inf for run in runs))


def held_in_stock(task: str, policy: Policy, episodes: int, robot: RobotConfig) -> Rate:
    """Rate of success_held in stock robosuite; shows a progress bar."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        running = bar.add_task("stock robosuite", total=episodes)
        settings = EpisodeSettings(task, robot, episodes=episodes)
        results = evaluate_policy(policy, settings, lambda n: bar.advance(running, n))
    return success_rate([episode.success_held for episode in results])


def table(task: str, runs: Sequence[TimedRun]) -> Table:
    """Make a table with one row per run."""
    title = f"{task}: wall time to {GOAL:.0%} success_held in stock robosuite"
    rows = Table("learner", title=title)
    for column in COLUMNS:
        rows.add_column(column, justify="right")
    for run in runs:
        rows.add_row(*_cells(run))
    return rows


def _cells(run: TimedRun) -> tuple[str, ...]:
    rate = run.success_held
    return (
        run.learner,
        str(run.seed),
        f"{run.seconds:,.1f}",
        f"{run.env_steps:,}",
        f"{rate.rate:.1%}",
        f"{rate.low:.0%} - {rate.high:.0%}",
        "reached" if run.reached else "missed",
    )


def summary(run: TimedRun) -> str:
    """Describe a run in one line."""
    if run.reached:
        return f"{run.learner}: {run.seconds:,.0f} s, {run.env_steps:,} steps"
    return (
        f"{run.learner}: goal missed after {run.seconds / 60:.0f} min: "
        f"success_held {run.success_held.rate:.0%} after {run.env_steps:,} steps"
    )
