"""The states of all jobs, from what an executor reports."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from statistics import fmean
from typing import Literal

from manip.cluster.job import Job, Outcome, Report

State = Literal["waiting", "running", "finished", "failed", "stopped"]


@dataclass
class Entry:
    """The state of a job.

    Attributes:
        job: what runs.
        state: how far it is.
        report: the latest one.
        began: when it began in this process; from time.monotonic.
        first_step: control steps that it had when it began.
        ended: when it ended.
        outcome: how it ended.
    """

    job: Job
    state: State = "waiting"
    report: Report = field(default_factory=Report)
    began: float = 0.0
    first_step: int | None = None
    ended: float | None = None
    outcome: Outcome | None = None

    @property
    def seconds(self) -> float:
        """Wall time since the job began."""
        return (self.ended or time.monotonic()) - self.began if self.began else 0.0

    @property
    def steps_left(self) -> int:
        """Control steps that are still to be taken."""
        return max(0, self.job.config.steps - self.report.env_steps)

    @property
    def seconds_per_step(self) -> float | None:
        """Measured wall time of a control step; None before the first steps."""
        steps = self.report.env_steps - (self.first_step or 0)
        return self.seconds / steps if steps > 0 and self.began else None


class Ledger:
    """A `Watch` that stores the states of jobs.

    Args:
        jobs: all of them.

    Attributes:
        entries: name of a job -> its state, in the order of the jobs.
    """

    def __init__(self, jobs: Sequence[Job]) -> None:
        self.entries = {job.name: Entry(job) for job in jobs}

    def started(self, job: Job) -> None:
        """A job begins."""
        entry = self.entries[job.name]
        entry.state, entry.began, entry.first_step = "running", time.monotonic(), None

    def reported(self, job: Job, report: Report) -> None:
        """A running job reports."""
        entry = self.entries[job.name]
        if entry.first_step is None:
            entry.first_step = report.env_steps
        entry.report = report

    def ended(self, job: Job, outcome: Outcome) -> None:
        """A job has ended."""
        entry = self.entries[job.name]
        entry.state, entry.outcome = outcome.status, outcome
        entry.ended = time.monotonic()

    @property
    def outcomes(self) -> dict[str, Outcome]:
        """Name of each job that has ended -> how."""
        return {n: e.outcome for n, e in self.entries.items() if e.outcome}

    def having(self, state: State) -> list[Entry]:
        """The entries in a state."""
        return [entry for entry in self.entries.values() if entry.state == state]

    def seconds_left(self) -> float | None:
        """Estimate of the wall time until all jobs have ended; None before any step.

        The steps that are left, each as long as those measured for the same task and
        algorithm (for all, where there are none), on as many processes as run now.
        Final evaluations are left out.
        """
        left = [*self.having("waiting"), *self.having("running")]
        known = dict(self._seconds_per_step())
        if not known:
            return None
        typical = fmean(known.values())
        work = [e.steps_left * known.get(_kind(e), typical) for e in left]
        return sum(work) / max(1, len(self.having("running")))

    def _seconds_per_step(self) -> Iterator[tuple[tuple[str, str], float]]:
        """(task, algorithm), mean of what their jobs measured."""
        entries = self.entries.values()
        for kind in {_kind(entry) for entry in entries}:
            measured = [e.seconds_per_step for e in entries if _kind(e) == kind]
            values = [value for value in measured if value is not None]
            if values:
                yield kind, fmean(values)


def _kind(entry: Entry) -> tuple[str, str]:
    return entry.job.config.task, entry.job.config.algo
