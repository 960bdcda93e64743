"""Choose where jobs run, and run them with their states on the terminal."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Event

from manip.cluster.job import Executor, Job, JobResult, Outcome, finished_result
from manip.cluster.jobs_display import JobsDisplay
from manip.cluster.ledger import Ledger
from manip.cluster.local_executor import LocalExecutor
from manip.cpus import usable_cpus
from manip.errors import UserError, at_least
from manip.training.config import TrainConfig
from manip.training.final_evaluation import EvaluationOptions
from manip.training.lifecycle import SignalHandler
from manip.training.run_folder import check_run_options

Ended = Callable[[dict[str, Outcome]], object]
"""Called after each job with the outcomes so far."""


def local_executor(
    jobs: Sequence[Job], processes: int | None, logs: Path | None = None
) -> tuple[Executor, list[Job]]:
    """An executor on this machine, and the jobs with the threads that fit it.

    Runs gain more from a core each than from several threads, so there are as many
    processes as usable CPUs. CPUs that fewer runs leave over become threads of these.

    Args:
        jobs: to run; those that set their number of threads keep it.
        processes: runs at a time, if not as many as CPUs.
        logs: folder for the messages of each run.

    Raises:
        UserError: less than one process is requested.
    """
    cpus = usable_cpus()
    if processes is not None:
        at_least(1, "--processes", processes)
    least = max((job.config.threads or 1 for job in jobs), default=1)
    count = min(processes or max(1, cpus // least), max(1, len(jobs)))
    return LocalExecutor(count, logs), with_threads(jobs, max(1, cpus // count))


def with_threads(jobs: Sequence[Job], threads: int) -> list[Job]:
    """The jobs with a number of threads for those that set none."""
    return [
        replace(job, config=replace(job.config, threads=job.config.threads or threads))
        for job in jobs
    ]


def run_jobs(
    jobs: Sequence[Job], executor: Executor, ended: Ended = lambda _: None
) -> dict[str, Outcome]:
    """Run the jobs that have not finished yet; show their states on stderr.

    On the main thread, the first Ctrl-C, SIGTERM or SIGHUP saves all runs and ends; a
    second one ends at once.

    Args:
        jobs: with unique names and folders.
        executor: runs them.
        ended: called with the outcomes so far, before the first job and after each.

    Returns:
        name -> outcome, for all jobs that have ended now or before.

    Raises:
        UserError: a result in a job's folder is damaged.
    """
    results = {job.name: finished_result(job) for job in jobs}
    before = {n: Outcome("finished", r) for n, r in results.items() if r}
    left = [job for job in jobs if job.name not in before]

    def pass_on(ledger: Ledger) -> None:
        ended(before | ledger.outcomes)

    ended(before)
    stop = Event()
    with JobsDisplay(left, len(before), pass_on) as display, SignalHandler(stop.set):
        executor(left, display, stop)
    return before | display.ledger.outcomes


def finish_runs(
    runs: Sequence[TrainConfig],
    processes: int | None,
    evaluation: EvaluationOptions | None = None,
) -> list[JobResult] | None:
    """Train all runs in processes of this machine, or resume them, and evaluate them.

    Args:
        runs: their options; each has a folder of its own.
        processes: runs at a time; one for each usable CPU unless given.
        evaluation: at the end of each run.

    Returns:
        the results in the order of the runs; None if they were interrupted, and saved.

    Raises:
        UserError: a folder holds a run with other options, or a run failed.
    """
    jobs = [Job(str(run.folder), run, evaluation) for run in runs]
    for run in runs:
        check_run_options(run)
    executor, jobs = local_executor(jobs, processes)
    outcomes = run_jobs(jobs, executor)
    names = [job.name for job in jobs]
    for name, outcome in outcomes.items():
        if outcome.status == "failed":
            raise UserError(f"{name}: {outcome.error}")
    results = [o.result for o in map(outcomes.get, names) if o and o.result]
    return results if len(results) == len(jobs) else None
