"""The worker process of a local executor: runs jobs that its parent sends."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Event

import torch

from manip.cluster.job import Job, Outcome, Report
from manip.cluster.run_job import run_job
from manip.envs.backends.worker_pool import end_with_parent
from manip.sim.robosuite_log import quiet_robosuite

REPORT_EVERY = 0.2
"""Seconds between two reports of a job on this machine."""


def log_of(job: Job, logs: Path | None) -> Path:
    """Text file of a job's messages and prints; they are dropped without a folder."""
    return logs / f"{job.name}.log" if logs else Path(os.devnull)


def append_lines(path: Path, lines: Iterable[str]) -> None:
    """Append lines to a text file, in a folder that may be missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.writelines(f"{line}\n" for line in lines)


class Reporter:
    """Pass on reports every few seconds at most, those with messages always.

    Args:
        send: receives the reports.
        log: text file that messages are appended to.
        every: seconds between two reports.
    """

    def __init__(
        self,
        send: Callable[[Report], object],
        log: Path,
        every: float = REPORT_EVERY,
    ) -> None:
        self._send, self._log, self._every = send, log, every
        self._last = 0.0

    def __call__(self, report: Report) -> None:
        """Pass on the report, or drop it."""
        now = time.monotonic()
        if report.messages:
            append_lines(self._log, report.messages)
        elif now - self._last < self._every:
            return
        self._last = now
        self._send(report)


def serve(connection: Connection, logs: Path | None) -> None:
    """Run jobs in a worker process until the parent closes the pipe."""
    end_with_parent()
    for number in (signal.SIGINT, signal.SIGHUP):  # the parent handles them
        signal.signal(number, signal.SIG_IGN)
    quiet_robosuite()
    torch.set_num_threads(1)
    while (job := _next_job(connection)) is not None:
        log = log_of(job, logs)
        with printing_to(log):
            outcome = _run_for_parent(job, connection, log)
        with suppress(BrokenPipeError):  # the next job does not come then
            connection.send(outcome)


def _next_job(connection: Connection) -> Job | None:
    """The next job; None when there is none any more."""
    with suppress(EOFError, OSError):
        while True:
            message = connection.recv()
            if message is not None:  # a request to stop that came after the end
                job: Job = message
                return job
    return None


def _run_for_parent(job: Job, connection: Connection, log: Path) -> Outcome:
    stop, reporter = Event(), Reporter(connection.send, log)

    def send(report: Report) -> None:
        if connection.poll():
            connection.recv()
            stop.set()
        reporter(report)

    return run_job(job, send, stop)


@contextmanager
def printing_to(path: Path) -> Iterator[None]:
    """Append what this process prints, libraries included, to a text file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    before = [os.dup(1), os.dup(2)]
    with path.open("a", encoding="utf-8") as file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for number, copy in zip((1, 2), before, strict=True):
            os.dup2(copy, number)
            os.close(copy)
