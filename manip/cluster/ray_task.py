"""A job on a node of a Ray cluster."""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Any

import ray
import torch

from manip.cluster.job import Job, Outcome, Report
from manip.cluster.local_worker import Reporter
from manip.cluster.ray_head import Setup
from manip.cluster.run_job import run_job
from manip.io.atomic_files import is_partial
from manip.sim.robosuite_log import quiet_robosuite
from manip.versions import differences

CHECKPOINT = Path("checkpoints/latest.safetensors")

REPORT_EVERY = 2.0
"""Seconds between two reports of a job: one actor receives those of all nodes."""

LAST = ("checkpoints", "result.json")
"""What is brought back after all else: a copy that ends in between then holds a
checkpoint that is older than its other files, as after a kill, and no result."""


def run_on_node(job: Job, head: Any, setup: Setup) -> Outcome | None:
    """Run a job on this node, with its files where the sweep can read them.

    Args:
        job: what to run.
        head: the actor of `Head`.
        setup: of the sweep's machine.

    Returns:
        how it ended; None if the sweep was stopped before.
    """
    if different := differences(setup.versions):
        return Outcome("failed", error=different)
    if not ray.get(head.begin.remote(job.name)):
        return None
    quiet_robosuite()
    torch.set_num_threads(1)
    if _shares(setup):
        return _run(job, head)
    with _brought_back(job, head) as (local, bring_back):
        outcome = _run(local, head, bring_back)
        bring_back()
    return outcome


def _shares(setup: Setup) -> bool:
    """Whether this node has the sweep's storage; if so, work in the same directory."""
    if not (setup.directory / setup.token).is_file():
        return False
    os.chdir(setup.directory)
    return True


def _run(
    job: Job, head: Any, bring_back: Callable[[], object] = lambda: None
) -> Outcome:
    stop = Event()

    def send(report: Report) -> None:
        if ray.get(head.report.remote(job.name, report)):
            stop.set()
        bring_back()

    return run_job(job, Reporter(send, Path(os.devnull), REPORT_EVERY), stop)


@contextmanager
def _brought_back(job: Job, head: Any) -> Iterator[tuple[Job, Callable[[], None]]]:
    """A job in a temporary folder that holds its files so far.

    Yields the job, and a function that brings its files back if there is a new
    checkpoint or an end.
    """
    with tempfile.TemporaryDirectory(prefix="manip-") as scratch:
        folder = Path(scratch) / job.name
        for path, content in ray.get(head.files.remote(job.name)).items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        yield (
            replace(job, config=replace(job.config, out=folder)),
            _FilesBack(job.name, folder, head),
        )


class _FilesBack:
    """Brings back the files of a run that have changed, once it has a new checkpoint.

    Args:
        name: of the job.
        folder: its run folder on this node.
        head: the actor that stores the files.
    """

    def __init__(self, name: str, folder: Path, head: Any) -> None:
        self._name, self._folder, self._head = name, folder, head
        self._brought = self._states()

    def __call__(self) -> None:
        """Bring back what has changed if a checkpoint or the result is new."""
        states = self._states()
        changed = [p for p, state in states.items() if self._brought.get(p) != state]
        if not any(str(path).startswith(LAST) for path in changed):
            return
        for path in sorted(changed, key=_order):
            content = (self._folder / path).read_bytes()
            ray.get(self._head.store.remote(self._name, str(path), content))
        self._brought = states

    def _states(self) -> dict[Path, tuple[int, int]]:
        """Relative path -> time of the last change, and inode."""
        paths = [p for p in self._folder.rglob("*") if p.is_file()]
        files = [p for p in paths if not is_partial(p) and p.name != "run.lock"]
        stats = {p.relative_to(self._folder): p.stat() for p in files}
        return {path: (stat.st_mtime_ns, stat.st_ino) for path, stat in stats.items()}


def _order(path: Path) -> tuple[bool, bool, str]:
    """Checkpoints late, the latest one after the others, the result last."""
    text = str(path)
    return text.startswith(LAST), path == CHECKPOINT or text == "result.json", text
