"""Run jobs in processes of this machine, or one after another in this process."""

import signal
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Event

from manip.cluster.job import Job, Outcome, Report, Watch
from manip.cluster.local_worker import Reporter, log_of, serve
from manip.cluster.run_job import run_job
from manip.evaluation.runners import interrupts_blocked

POLL = 0.5
"""Seconds after which the parent looks whether it is to stop."""


@dataclass
class _Worker:
    """A process that runs jobs one after another, and its present job."""

    process: BaseProcess
    connection: Connection
    job: Job | None = None


class LocalExecutor:
    """Run jobs in worker processes; see `manip.cluster.job.Executor`.

    A worker that dies fails its job only, and another process takes its place. When
    this process ends, however it ends, so do the workers.

    Args:
        processes: jobs at a time. With 1, jobs run in this very process.
        logs: folder with a text file per job: the messages of its run, and what it
            prints. Nothing is recorded unless given.
    """

    def __init__(self, processes: int, logs: Path | None = None) -> None:
        self._processes, self._logs = processes, logs
        self._workers: list[_Worker] = []

    def __call__(self, jobs: Sequence[Job], watch: Watch, stop: Event) -> None:
        """Run the jobs; returns when all have ended or, after `stop`, are saved."""
        if self._processes == 1:
            self._run_here(jobs, watch, stop)
            return
        try:
            self._run(deque(jobs), watch, stop)
        finally:
            self._end_workers()

    def _run_here(self, jobs: Sequence[Job], watch: Watch, stop: Event) -> None:
        for job in jobs:
            if stop.is_set():
                return
            watch.started(job)
            reporter = Reporter(partial(watch.reported, job), log_of(job, self._logs))
            outcome = run_job(job, reporter, stop)
            watch.ended(job, outcome)
            if outcome.status == "stopped" and not outcome.error:
                return  # by a signal, which the run has handled

    def _run(self, waiting: deque[Job], watch: Watch, stop: Event) -> None:
        stopping = False
        while (waiting and not stopping) or self._busy():
            if stop.is_set() and not stopping:
                stopping = True
                self._ask_to_stop()
            while waiting and not stopping and len(self._busy()) < self._processes:
                self._start(waiting.popleft(), watch)
            for connection in wait([w.connection for w in self._busy()], POLL):
                self._receive(self._worker_of(connection), watch, stopping)

    def _busy(self) -> list[_Worker]:
        return [worker for worker in self._workers if worker.job]

    def _worker_of(self, connection: object) -> _Worker:
        return next(w for w in self._workers if w.connection is connection)

    def _start(self, job: Job, watch: Watch) -> None:
        idle = [worker for worker in self._workers if not worker.job]
        worker = idle[0] if idle else self._new_worker()
        worker.job = job
        watch.started(job)
        with suppress(BrokenPipeError):  # it has died: the next `recv` says so
            worker.connection.send(job)

    def _new_worker(self) -> _Worker:
        context = get_context("spawn")
        ours, other = context.Pipe()
        process = context.Process(target=serve, args=(other, self._logs))
        with interrupts_blocked():
            process.start()
        other.close()
        worker = _Worker(process, ours)
        self._workers.append(worker)
        return worker

    def _receive(self, worker: _Worker, watch: Watch, stopping: bool) -> None:
        assert worker.job is not None
        job = worker.job
        try:
            message = worker.connection.recv()
        except (EOFError, OSError):
            self._workers.remove(worker)
            message = _outcome_of_death(worker.process, stopping)
            worker.connection.close()
        if isinstance(message, Report):
            watch.reported(job, message)
            return
        worker.job = None
        watch.ended(job, message)

    def _ask_to_stop(self) -> None:
        for worker in self._busy():
            with suppress(BrokenPipeError):
                worker.connection.send(None)

    def _end_workers(self) -> None:
        """End all workers: idle ones find their pipe closed, busy ones are killed."""
        for worker in self._workers:
            worker.connection.close()
            if worker.job:
                worker.process.kill()
        for worker in self._workers:
            worker.process.join()
        self._workers = []


def _outcome_of_death(process: BaseProcess, stopping: bool) -> Outcome:
    process.join()
    if stopping:
        return Outcome("stopped")
    code = process.exitcode or 0
    how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
    hint = ": is there too little memory?" if code == -signal.SIGKILL else ""
    return Outcome("failed", error=f"the process of the run ended {how}{hint}")
