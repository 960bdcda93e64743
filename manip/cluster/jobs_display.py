"""Show many jobs: a live table on terminals, a line per job in logs."""

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from types import TracebackType

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from manip.cluster.job import Job, Outcome, Report
from manip.cluster.ledger import Entry, Ledger
from manip.io.printable import printable

FAILED_ROWS = 5
"""Failed jobs in the live table; their lines above it list all."""


class JobsDisplay:
    """A `Watch` that prints the states of jobs on stderr.

    Args:
        jobs: those that are to run.
        finished: number of further jobs that had finished before.
        ended: called with the ledger after each job.

    Attributes:
        ledger: states of the jobs.
    """

    def __init__(
        self,
        jobs: Sequence[Job],
        finished: int = 0,
        ended: Callable[[Ledger], object] = lambda _: None,
    ) -> None:
        self.ledger = Ledger(jobs)
        self._finished, self._on_end = finished, ended
        self._console = Console(file=sys.stderr)
        self._live = Live(
            get_renderable=self._table,
            console=self._console,
            refresh_per_second=2,
            transient=True,
        )

    def __enter__(self) -> "JobsDisplay":
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._live.stop()

    def started(self, job: Job) -> None:
        """A job begins."""
        again = self.ledger.entries[job.name].state == "running"
        self.ledger.started(job)
        if again:
            self.say(f"{job.name} was lost and continues from its last checkpoint")

    def reported(self, job: Job, report: Report) -> None:
        """A running job reports."""
        self.ledger.reported(job, report)

    def ended(self, job: Job, outcome: Outcome) -> None:
        """A job has ended: print a line."""
        self.ledger.ended(job, outcome)
        self.say(f"{self._count()} {job.name} {describe(outcome)}{self._left()}")
        self._on_end(self.ledger)

    def say(self, text: str) -> None:
        """Print a line, above the table if there is one."""
        self._console.print(
            printable(text), markup=False, highlight=False, soft_wrap=True
        )

    def _count(self) -> str:
        total = self._finished + len(self.ledger.entries)
        return f"[{self._finished + len(self.ledger.outcomes)}/{total}]"

    def _left(self) -> str:
        seconds = self.ledger.seconds_left()
        return f", about {duration(seconds)} left" if seconds else ""

    def _table(self) -> RenderableType:
        table = Table("run", "steps", "steps/s", "success_held", "time", box=None)
        for entry in self.ledger.having("running"):
            table.add_row(*map(Text, _cells(entry)))
        failed = self.ledger.having("failed")[-FAILED_ROWS:]
        errors = [Text(f"failed: {e.job.name}", style="red") for e in failed]
        return Group(table, *errors, Text(self._summary(), style="bold"))

    def _summary(self) -> str:
        count = Counter(entry.state for entry in self.ledger.entries.values())
        shown = [
            f"{count[state]} {state}" for state in ("running", "waiting", "failed")
        ]
        finished = self._finished + count["finished"]
        return ", ".join([*shown, f"{finished} finished"]) + self._left()


def describe(outcome: Outcome) -> str:
    """How a job ended, in words."""
    result = outcome.result
    if outcome.status == "failed":
        return f"failed: {outcome.error}"
    if result is None:
        return f"is saved and waits: {outcome.error}" if outcome.error else "is saved"
    rates = result.success or result.training
    where = f"{result.evaluation['env']}" if result.evaluation else "training"
    rate = rates.get("success_held")
    success = "" if rate is None else f": success_held {rate:.0%} in {where}"
    return f"finished{success}, trained in {duration(result.seconds)}"


def duration(seconds: float) -> str:
    """A time as 45 s, 12 min or 3.4 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _cells(entry: Entry) -> tuple[str, ...]:
    report = entry.report
    planned = max(entry.job.config.steps, report.env_steps)  # --until makes runs longer
    steps = f"{report.env_steps:,} of {planned:,}"
    if report.episodes and entry.job.evaluation:
        steps = f"evaluated {report.episodes} of {entry.job.evaluation.episodes}"
    success = "" if report.success is None else f"{report.success:.0%}"
    speed = f"{report.steps_per_second:,.0f}" if report.steps_per_second else ""
    return entry.job.name, steps, speed, success, duration(entry.seconds)
