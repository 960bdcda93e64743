"""Run jobs as tasks of a Ray cluster, which starts them again if their node dies."""

from collections.abc import Sequence
from pathlib import Path
from secrets import token_hex
from threading import Event
from typing import Any

from manip.cluster.job import Job, Outcome, Watch
from manip.cluster.local_worker import append_lines, log_of
from manip.cluster.ray_cluster import connected
from manip.cluster.ray_head import Head, Setup
from manip.errors import one_line
from manip.versions import versions

POLL = 0.5
"""Seconds between two looks at the tasks."""

RETRIES = 20
"""Times that Ray starts a task again whose node or process was lost."""


class RayExecutor:
    """Run jobs as Ray tasks; see `manip.cluster.job.Executor`.

    Where the nodes see the sweep's folder (shared storage), runs write to it. Elsewhere
    they write to a temporary folder, and their files are brought back at each
    checkpoint. A run whose node dies continues from its last checkpoint on another.

    Args:
        address: of the cluster, "host:port", or "auto" for the one that this machine
            belongs to.
        folder: of the sweep; folders of all jobs are in it.
        logs: folder for the messages of each run.

    Raises:
        UserError: Ray is not installed, or there is no cluster at the address.
    """

    def __init__(self, address: str, folder: Path, logs: Path | None = None) -> None:
        self._ray = connected(address)
        self._folder, self._logs = folder, logs
        self._begun: set[str] = set()

    def __call__(self, jobs: Sequence[Job], watch: Watch, stop: Event) -> None:
        """Run the jobs; returns when all have ended or, after `stop`, are saved."""
        token = self._folder / f".token-{token_hex(8)}"
        self._folder.mkdir(parents=True, exist_ok=True)
        token.touch()
        try:
            self._run(jobs, watch, stop, token)
        finally:
            token.unlink(missing_ok=True)
            self._ray.shutdown()

    def _run(self, jobs: Sequence[Job], watch: Watch, stop: Event, token: Path) -> None:
        setup = Setup(Path.cwd(), token, versions())
        head = self._start_head({job.name: job.config.folder for job in jobs})
        tasks = {self._submit(job, head, setup): job for job in jobs}
        by_name = {job.name: job for job in jobs}
        while tasks:
            if stop.is_set():
                self._cancel_waiting(tasks, head)
            done, _ = self._ray.wait([*tasks], timeout=POLL)
            self._pass_on(head, by_name, watch)
            for task in done:
                job = tasks.pop(task)
                outcome = self._outcome(task)
                if outcome is None and job.name in self._begun:
                    outcome = Outcome("stopped")  # its node was lost on the way
                if outcome:
                    watch.ended(job, outcome)

    def _start_head(self, folders: dict[str, Path]) -> Any:
        """An actor beside this process, which all tasks can call."""
        here = self._ray.get_runtime_context().get_node_id()
        scheduling = self._ray.util.scheduling_strategies
        beside = scheduling.NodeAffinitySchedulingStrategy(here, soft=False)
        actor = self._ray.remote(num_cpus=0, scheduling_strategy=beside)(Head)
        return actor.remote({n: folder.absolute() for n, folder in folders.items()})

    def _submit(self, job: Job, head: Any, setup: Setup) -> Any:
        from manip.cluster.ray_task import run_on_node  # imports ray

        cpus = job.config.threads or 1
        task = self._ray.remote(num_cpus=cpus, max_retries=RETRIES)(run_on_node)
        return task.remote(job, head, setup)

    def _cancel_waiting(self, tasks: dict[Any, Job], head: Any) -> None:
        """Have running tasks save and end; those that have not begun never will."""
        begun = self._ray.get(head.stop.remote())
        for task, job in tasks.items():
            if job.name not in begun:
                self._ray.cancel(task)

    def _pass_on(self, head: Any, jobs: dict[str, Job], watch: Watch) -> None:
        for name, report in self._ray.get(head.take.remote()):
            if report is None:
                self._begun.add(name)
                watch.started(jobs[name])
                continue
            append_lines(log_of(jobs[name], self._logs), report.messages)
            watch.reported(jobs[name], report)

    def _outcome(self, task: Any) -> Outcome | None:
        """How a task ended; None if it was to stop before it began, here or anew."""
        try:
            outcome: Outcome | None = self._ray.get(task)
        except self._ray.exceptions.TaskCancelledError:
            return None
        except self._ray.exceptions.RayError as error:
            return Outcome("failed", error=f"Ray: {one_line(error)}")
        return outcome
