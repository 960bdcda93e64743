"""Print the reports of a run on stderr: a live line on terminals, lines in logs."""

import sys
from collections.abc import Callable
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from manip.training.progress import Progress as RunProgress


class _Console(Console):
    """A console whose reader may go away: rich would end the process then."""

    def on_broken_pipe(self) -> None:
        self.quiet = True


class TerminalProgress:
    """A training callback that shows steps, speed, success, milestones and time left.

    Output never ends a run: where it cannot be written (its reader has gone, or the
    terminal has no such character), it is dropped.
    """

    def __init__(self) -> None:
        self._console = _Console(file=sys.stderr, quiet=sys.stderr is None)
        self._bar = Progress(
            TextColumn("training"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[line]}", markup=False),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("", total=None, line="")

    def __enter__(self) -> "TerminalProgress":
        self._write(self._bar.start)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._write(self._bar.stop)

    def __call__(self, progress: RunProgress) -> None:
        """Show a report: its messages as lines above the bar."""
        for message in progress.messages:
            self.say(message)
        self._write(lambda: self._update(progress))

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        self._write(
            lambda: self._console.print(
                text, markup=False, highlight=False, soft_wrap=True
            )
        )

    def _update(self, progress: RunProgress) -> None:
        self._bar.update(
            self._task,
            total=progress.total_steps,
            completed=progress.env_steps,
            line=_line(progress),
        )

    def _write(self, write: Callable[[], object]) -> None:
        try:
            write()
        except (OSError, UnicodeError, ValueError):  # ValueError: a closed file
            self._console.quiet = True


def _line(progress: RunProgress) -> str:
    line = f"{progress.steps_per_second:,.0f} steps/s"
    if "train/success_held" not in progress.averages:
        return line
    for name in (*progress.milestones, "success_held"):
        line += f"  {name} {progress.averages[f'train/{name}']:.0%}"
    return line
