"""`manip check`: check a task of your own before training."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
import tyro
from rich.table import Table
from rich.text import Text

from manip.envs.external_task import ExternalTask
from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.envs.waypoint_states import ROUNDS, STATES, Yield, measure_yields
from manip.errors import UserError
from manip.evaluation.task_problems import (
    TaskBackends,
    open_task,
    range_problems,
    start_problems,
    step_problems,
)
from manip.evaluation.task_ranges import TaskRanges, measure_ranges
from manip.io.printable import printable
from manip.programs import cli
from manip.programs.output import console
from manip.robot_config import RobotConfig


@dataclass(frozen=True)
class Check:
    """Check a task before training, in about a minute.

    Start states and steps are compared with robosuite's own; the expert and random
    actions show which rewards are paid and how large the observations are. Of each
    waypoint, some states are generated, to show how many are valid. The exit code is 0
    without problems, else 1.
    """

    task: Annotated[str, tyro.conf.Positional]
    """Task (see `manip list`), or package.module:Class."""
    robot: str = "Panda"
    """Robot arm."""
    episodes: int = 20
    """Episodes of the expert, and of random actions."""


def main(arguments: Sequence[str]) -> int:
    """Check a task; 0 if no problem was noticed, else 1."""
    options = cli.parse(Check, arguments, "manip check")
    cli.check_range("--episodes", options.episodes, 1, 1000)
    torch.set_num_threads(1)
    task = load_task(options.task)
    if isinstance(task, ExternalTask):
        raise UserError(f"{task.name} is stepped by {task.library}: nothing to compare")
    backends = open_task(task, RobotConfig(options.robot))
    ranges = measure_ranges(task, backends.scene, options.episodes)
    console().print(_observations(ranges))
    console().print(_rewards(task, ranges))
    console().print(f"expert: {_expert(ranges)}", markup=False)
    yields = measure_yields(task, backends.scene)
    for name, counts in yields.items():
        console().print(f"waypoint {name}: {counts}", markup=False, soft_wrap=True)
    problems = [*_problems(backends, ranges), *yield_problems(yields)]
    for problem in problems:
        line = printable(f"problem: {problem}")
        console().print(line, markup=False, soft_wrap=True)
    if not problems:
        console().print("no problem: native and stock agree, rewards are in range")
    return 1 if problems else 0


def _problems(task: TaskBackends, ranges: TaskRanges) -> list[str]:
    problems = [*start_problems(task), *step_problems(task)]
    problems += range_problems(ranges.observations, ranges.terms, ranges.reward)
    if ranges.expert_success is not None and ranges.expert_success.rate < 1:
        problems.append(f"the expert succeeds in {ranges.expert_success.rate:.0%} only")
    return problems


def yield_problems(yields: Mapping[str, Yield]) -> Iterator[str]:
    """Waypoints of which too few candidates are valid, by name."""
    for name, counts in yields.items():
        if counts.enough_for(STATES, ROUNDS):
            continue
        yield (
            f"waypoint {name}: training needs {STATES} states, and would not get them "
            "from sample_waypoint"
        )


def _expert(ranges: TaskRanges) -> str:
    if ranges.expert_success is None:
        return "none (--algo bc needs one)"
    rate = ranges.expert_success
    return f"success_held {rate.rate:.0%} ({rate.low:.0%}-{rate.high:.0%}), native"


def _observations(ranges: TaskRanges) -> Table:
    table = Table("observation part", "size", "least", "mean", "greatest")
    for name, part in ranges.observations.items():
        numbers = [part.min(initial=np.inf), part.mean(), part.max(initial=-np.inf)]
        cells = (name, str(part.shape[1]), *map(_short, numbers))
        table.add_row(*(Text(printable(cell)) for cell in cells))
    return table


def _rewards(task: Task, ranges: TaskRanges) -> Table:
    table = Table("reward term", "weight", "least", "greatest", "expert's mean")
    weights = task.weights["shaped"]
    rows = [(n, _short(weights[n]), ranges.terms[n]) for n in weights]
    for name, weight, values in [*rows, ("sum, weighted", "", ranges.reward)]:
        expert = values[: ranges.expert_steps]
        mean = _short(expert.mean()) if len(expert) else ""
        cells = (name, weight, _short(values.min()), _short(values.max()), mean)
        table.add_row(*(Text(printable(cell)) for cell in cells))
    return table


def _short(number: float) -> str:
    """Three digits; no minus before a zero."""
    return f"{number + 0.0:.3g}"
