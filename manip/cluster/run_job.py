"""Run one job in this process: train or resume, evaluate, write the result."""

import sys
import time
import traceback
from collections.abc import Callable
from threading import Event

from manip.cluster.job import (
    Job,
    JobResult,
    Outcome,
    Report,
    evaluation_key,
    finished_result,
    write_result,
)
from manip.errors import UserError, one_line
from manip.evaluation.report import Evaluation
from manip.io.atomic_files import write_text
from manip.training.final_evaluation import (
    EvaluationOptions,
    evaluate_on_task,
    load_run,
)
from manip.training.lifecycle import in_use
from manip.training.progress import Progress
from manip.training.run import RunResult, train_or_resume

Send = Callable[[Report], object]
"""Passes on the reports of a job."""

LOCK_WAIT = 60.0
"""Seconds to wait for another process to leave the run folder: one that was lost with
its machine, or killed, holds the lock until it has ended."""


class _Stopped(Exception):  # noqa: N818 - no error
    """The evaluation is to end."""


def run_job(job: Job, send: Send, stop: Event) -> Outcome:
    """Run a job from where it is; errors become an outcome.

    A run that is killed in between is resumed by the next call. A finished job is not
    repeated.

    Args:
        job: what to run.
        send: called after every rollout and every episode of the evaluation.
        stop: set it to have the job save and end soon.
    """
    try:
        return _run(job, send, stop)
    except UserError as error:
        return Outcome("failed", error=str(error))
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        return Outcome("failed", error=f"{type(error).__name__}: {one_line(error)}")


def _run(job: Job, send: Send, stop: Event) -> Outcome:
    result = finished_result(job)
    if result is None:
        _wait_for_lock(job, stop)
        trained = train_or_resume(
            job.config, callback=lambda progress: send(_report(progress)), stop=stop
        )
        if not trained.finished:
            return Outcome("stopped", error=trained.waiting)
        try:
            result = _result(trained, job, send, stop)
        except _Stopped:
            return Outcome("stopped")
        write_result(job.config.folder, result)
    return Outcome("finished", result)


def _wait_for_lock(job: Job, stop: Event) -> None:
    began = time.monotonic()
    while in_use(job.config.folder) and time.monotonic() - began < LOCK_WAIT:
        if stop.wait(0.5):
            return


def _report(progress: Progress) -> Report:
    return Report(
        env_steps=progress.env_steps,
        steps_per_second=progress.steps_per_second,
        success=progress.averages.get("train/success_held"),
        messages=progress.messages,
    )


def _result(trained: RunResult, job: Job, send: Send, stop: Event) -> JobResult:
    """The result of a trained run, evaluated as the job requests."""
    result = JobResult(trained.env_steps, trained.seconds, trained.success)
    if job.evaluation is None:
        return result
    evaluation = _evaluate(job, job.evaluation, send, stop)
    write_text(job.config.folder / "eval.json", evaluation.to_json())
    return JobResult(
        env_steps=result.env_steps,
        seconds=result.seconds,
        training=result.training,
        evaluation=evaluation_key(job.evaluation),
        success={name: rate.rate for name, rate in evaluation.success.items()},
        return_mean=evaluation.return_mean,
    )


def _evaluate(
    job: Job, options: EvaluationOptions, send: Send, stop: Event
) -> Evaluation:
    ended = 0

    def count(episodes: int) -> None:
        nonlocal ended
        ended += episodes
        send(Report(env_steps=job.config.steps, episodes=ended))
        if stop.is_set():
            raise _Stopped

    return evaluate_on_task(*load_run(job.config.folder), options, count)
