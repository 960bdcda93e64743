"""A live line on a terminal, plain lines in a log: where a training stands."""

import sys
import time
from collections.abc import Mapping, Sequence
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


class TrainingProgress:
    """Shows steps, steps/s, success, stage rates and time left while training."""

    def __init__(self, total: int, done: int, milestones: Sequence[str]) -> None:
        self.console = Console(file=sys.stderr)
        self._stages = milestones
        self._began, self._first = time.monotonic(), done
        self._bar = Progress(
            TextColumn("training"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[line]}", markup=False),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=self.console,
            disable=not self.console.is_terminal,
        )
        self._task = self._bar.add_task("", total=total, completed=done, line="")

    def __enter__(self) -> "TrainingProgress":
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()

    def update(self, env_steps: int, values: Mapping[str, float]) -> None:
        """Move the bar on; `values` are the latest training averages."""
        line = f"{self.speed(env_steps):,.0f} steps/s"
        if "train/success" in values:
            line += f"  success {values['train/success']:.0%}"
            line += "".join(f"  {s} {values[f'train/{s}']:.0%}" for s in self._stages)
        self._bar.update(self._task, completed=env_steps, line=line)

    def speed(self, env_steps: int) -> float:
        """Control steps a second since this process began to train."""
        seconds = max(time.monotonic() - self._began, 1e-9)
        return (env_steps - self._first) / seconds

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        self.console.print(text, markup=False, highlight=False, soft_wrap=True)
