"""A training run of many, its report while it goes on, and its result."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from threading import Event
from typing import Literal, Protocol

from manip.errors import UserError, one_line
from manip.io.atomic_files import write_text
from manip.io.dataclass_values import build
from manip.training.config import TrainConfig
from manip.training.final_evaluation import EvaluationOptions

RESULT = "result.json"
"""File of a run folder that is written when its job has finished."""


@dataclass(frozen=True)
class Job:
    """A training run and the evaluation at its end.

    Attributes:
        name: unique among the jobs that run together.
        config: options of the run, with its folder in `out`.
        evaluation: episodes of the final evaluation; None: there is none.
    """

    name: str
    config: TrainConfig
    evaluation: EvaluationOptions | None = None


@dataclass(frozen=True)
class Report:
    """State of a job that runs.

    Attributes:
        env_steps: control steps of training so far.
        steps_per_second: control steps a second, in this process.
        success: recent success_held of training episodes; None before the first.
        episodes: episodes of the final evaluation that have ended.
        messages: lines for people to read, new since the last report.
    """

    env_steps: int = 0
    steps_per_second: float = 0.0
    success: float | None = None
    episodes: int = 0
    messages: tuple[str, ...] = ()


@dataclass(frozen=True)
class JobResult:
    """Result of a finished job; the content of result.json.

    Attributes:
        env_steps: control steps of training.
        seconds: wall time of training, over all processes of the run.
        training: success_once, success_at_end and success_held of the best evaluation
            during training.
        evaluation: the options of the final evaluation; empty without one.
        success: the same rates in the final evaluation; empty without one.
        return_mean: mean return of its episodes; None without one.
    """

    env_steps: int
    seconds: float
    training: dict[str, float]
    evaluation: dict[str, str | int | bool] = field(default_factory=dict)
    success: dict[str, float] = field(default_factory=dict)
    return_mean: float | None = None


@dataclass(frozen=True)
class Outcome:
    """How a job ended.

    Attributes:
        status: finished, failed, or stopped (and saved) before its end.
        result: of a finished job.
        error: why it failed, or what a stopped one waits for, such as people's answers.
    """

    status: Literal["finished", "failed", "stopped"]
    result: JobResult | None = None
    error: str = ""


class Watch(Protocol):
    """Receives what happens to jobs, on the thread that waits for them."""

    def started(self, job: Job) -> None:
        """A job begins, or begins again after its machine was lost."""

    def reported(self, job: Job, report: Report) -> None:
        """A running job reports."""

    def ended(self, job: Job, outcome: Outcome) -> None:
        """A job has ended."""


class Executor(Protocol):
    """Runs jobs, and returns when all have ended or, after `stop` is set, are saved."""

    def __call__(self, jobs: Sequence[Job], watch: Watch, stop: Event) -> None:
        """Run the jobs; begin none once `stop` is set."""


def evaluation_key(options: EvaluationOptions | None) -> dict[str, str | int | bool]:
    """The options that decide the result of an evaluation, without those not set."""
    values = asdict(options) if options else {}
    return {k: v for k, v in values.items() if k != "processes" and v is not None}


def finished_result(job: Job) -> JobResult | None:
    """The result in the job's folder; None if there is none, or not all of it.

    Raises:
        UserError: the file is damaged.
    """
    path = job.config.folder / RESULT
    if not path.is_file():
        return None
    result = read_result(path)
    trained = result.env_steps >= job.config.steps
    same = result.evaluation == evaluation_key(job.evaluation)
    return result if trained and same else None


def read_result(path: Path) -> JobResult:
    """Read a result.json.

    Raises:
        UserError: it is damaged.
    """
    try:
        return build(JobResult, json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, RecursionError) as error:  # UserError, JSON, encoding
        raise UserError(f"{path} is damaged: {one_line(error)}; remove it") from error


def write_result(folder: Path, result: JobResult) -> None:
    """Write a result.json, atomically."""
    write_text(folder / RESULT, json.dumps(asdict(result), indent=2) + "\n")
