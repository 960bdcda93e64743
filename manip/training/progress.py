"""Progress: the report that a run passes to its callback."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Progress:
    """A run's report after a rollout, an evaluation and at its end.

    Attributes:
        env_steps: control steps taken so far, all environments together.
        total_steps: control steps of the whole run.
        seconds: wall time of training so far, over all processes of the run.
        steps_per_second: control steps a second of wall time, in this process.
        averages: recent training averages, as in the `train/` columns of metrics.csv.
        milestones: names of the task's milestones, which `averages` holds, too.
        messages: lines for people to read, new since the last report.
    """

    env_steps: int
    total_steps: int
    seconds: float
    steps_per_second: float
    averages: Mapping[str, float] = field(default_factory=dict)
    milestones: tuple[str, ...] = ()
    messages: tuple[str, ...] = ()


Callback = Callable[[Progress], object]
"""Receives a run's reports, on the thread that trains."""


def ignore(progress: Progress) -> None:
    """Drop a report (the default callback)."""
