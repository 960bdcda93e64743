"""`manip study`: measure what algorithms and their options do."""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from io import StringIO
from math import isnan
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from manip.agents.registry import algorithm_names, load_algorithm
from manip.envs.task_registry import load_task
from manip.errors import UserError, at_least
from manip.io.atomic_files import write_text
from manip.io.output_paths import check_output_folder
from manip.preferences.tastes import load_taste
from manip.programs import cli
from manip.programs.output import console, print_path
from manip.studies import gradient_figures, learning_figures
from manip.studies.gradients import GradientRow, GradientStudy, measure
from manip.studies.learning import (
    Evaluation,
    algorithm_variants,
    asynchrony_variants,
    clipping_variants,
    evaluations,
)
from manip.studies.motion_figure import draw_motion
from manip.studies.motion_study import MotionRow, default_policies, motion_rows
from manip.studies.rlhf import PreferenceRow, PreferenceStudy
from manip.studies.rlhf_figures import FIGURES
from manip.studies.rlhf_scores import Scorer
from manip.studies.rlhf_variants import HORIZON, PARTS, START, Part, Variants
from manip.training.config import TrainConfig

Measure = Callable[["Study"], list[Any]]
Draw = Callable[[Sequence[Any], Path], None]
Figures = Callable[["Study"], Mapping[str, Draw]]

RLHF_STEPS = 61_440
"""Control steps of a run of `rlhf`: 30 rollouts of 64 environments."""

FEWEST_ROLLOUTS = 8
"""Fewer do not give a covariance and its bootstrap intervals."""


def reward_algorithms() -> tuple[str, ...]:
    """Names of the algorithms that learn from the task's reward."""
    algorithms = {name: load_algorithm(name) for name in algorithm_names()}
    return tuple(
        name
        for name, algorithm in algorithms.items()
        if not algorithm.imitates and not algorithm.needs_preferences
    )


@dataclass(frozen=True)
class Study:
    """Run a study with several seeds; write a table (.csv) and figures (.png).

    gradients: noise of policy gradients (REINFORCE, with a baseline, actor-critic), and
    noise and bias against n of n-step returns, with bootstrap intervals: variance.png
    and bias.png.

    clipping: PPO's epochs with and without clipping.

    asynchrony: A3C with workers in turns and asynchronous, the latter twice with the
    same seeds.

    algorithms: all algorithms, success against control steps and computing time.

    rlhf: learning from preferences, with simulated labellers: methods at equal labels,
    over-optimisation, number of labels, inputs of the reward model, flawed labellers.

    motion: peak speed, torque and jerk of each policy beside the arm's limits, tilt of
    the hand, contacts of the arm with itself. Trains nothing.
    """

    what: Annotated[
        Literal["gradients", "clipping", "asynchrony", "algorithms", "rlhf", "motion"],
        tyro.conf.Positional,
    ]
    """Study to run."""
    tasks: tuple[str, ...] = ()
    """Tasks; Reach unless given, or Lift for `rlhf`. Only `algorithms` uses more than
    the first."""
    algos: tuple[str, ...] = field(default_factory=reward_algorithms)
    """Algorithms that `algorithms` compares; by default all that learn from rewards."""
    seeds: int = 3
    """Number of runs of each variant, with seeds 0, 1, ...; more seeds narrow the
    intervals."""
    steps: int | None = None
    """Control steps of a run; by default as many as its recipe has, or 61,440 for
    `rlhf`."""
    stages: tuple[int, ...] = (5_000, 20_000, 80_000)
    """Control steps of training after which `gradients` measures."""
    gamma: float = 0.97
    """Discount factor of `gradients`."""
    rollouts: int = 60
    """Rollouts per stage of `gradients`; more rollouts give narrower intervals."""
    length: int = 40
    """Control steps at the start of an episode that enter a gradient."""
    parts: tuple[Part, ...] = PARTS
    """Parts of `rlhf`, a figure each; runs that several parts need are made once."""
    taste: str = "gentle"
    """Taste of the labellers of `rlhf` (see `manip list`)."""
    policies: tuple[str, ...] = ()
    """Policies of `motion`: run folders, policy folders, names of shipped policies; all
    shipped ones unless given, except those that see images."""
    episodes: int = 100
    """Episodes in which `rlhf` and `motion` run each policy; more give more accurate
    values."""
    processes: int | None = None
    """Number of runs at a time; one for each usable CPU unless given."""
    out: Path = Path("runs/study")
    """Folder for tables, figures and runs; finished runs in it are not repeated."""


def main(arguments: Sequence[str]) -> int:
    """Run the study and print the paths of its results."""
    options = _with_tasks(cli.parse(Study, arguments, "manip study"))
    _check(options)
    options.out.mkdir(parents=True, exist_ok=True)
    measure_rows, figures = STUDIES[options.what]
    rows = measure_rows(options)
    table = options.out / f"{options.what}.csv"
    write_text(table, _table(rows))
    print_path(table)
    for name, draw in figures(options).items():
        picture = options.out / f"{name}.png"
        draw(rows, picture)
        print_path(picture)
    return 0


def _with_tasks(options: Study) -> Study:
    default = "Lift" if options.what == "rlhf" else "Reach"
    return replace(options, tasks=options.tasks or (default,))


def _check(options: Study) -> None:
    for name in ("seeds", "length", "episodes"):
        at_least(1, f"--{name}", getattr(options, name))
    at_least(FEWEST_ROLLOUTS, "--rollouts", options.rollouts)
    for name in ("steps", "processes"):
        if getattr(options, name) is not None:
            at_least(1, f"--{name}", getattr(options, name))
    for stage in options.stages:
        at_least(0, "--stages", stage)
    if not 0 <= options.gamma <= 1:
        raise UserError(f"--gamma must be from 0 to 1, not {options.gamma}")
    _check_names(options)
    check_output_folder(options.out, "--out")


def _check_names(options: Study) -> None:
    for name in ("algos", "stages", "parts"):
        if not getattr(options, name):
            raise UserError(f"--{name} must name at least one")
    for task in options.tasks:
        load_task(task)


def _gradients(options: Study) -> list[GradientRow]:
    study = GradientStudy(
        options.tasks[0],
        options.gamma,
        sorted(set(options.stages)),
        options.rollouts,
        options.length,
    )
    rows = []
    for seed in range(options.seeds):
        for stage in measure(study, seed):
            rows += stage
            console().print(_progress(study, stage[0]), highlight=False)
    return rows


def _progress(study: GradientStudy, row: GradientRow) -> str:
    text = f"seed {row.seed}: {study.rollouts} gradients after {row.env_steps:,} steps"
    if isnan(row.noise):
        text += ": too few to tell the gradient from zero, increase --rollouts"
    return text


def _clipping(options: Study) -> list[Evaluation]:
    variants = clipping_variants(options.tasks[0], options.steps)
    return _evaluations(options, variants)


def _asynchrony(options: Study) -> list[Evaluation]:
    variants = asynchrony_variants(options.tasks[0], options.steps)
    return _evaluations(options, variants)


def _algorithms(options: Study) -> list[Evaluation]:
    variants = [
        algorithm_variants(task, options.algos, options.steps) for task in options.tasks
    ]
    return [row for group in variants for row in _evaluations(options, group)]


def _evaluations(
    options: Study, variants: Mapping[str, TrainConfig]
) -> list[Evaluation]:
    seeds = range(options.seeds)
    return evaluations(variants, seeds, options.out / "runs", options.processes)


def _rlhf(options: Study) -> list[PreferenceRow]:
    task, taste = options.tasks[0], options.taste
    load_taste(task, taste)
    steps = RLHF_STEPS if options.steps is None else options.steps
    if steps < 2 * START:
        raise UserError(f"--steps must be at least {2 * START} for rlhf, not {steps}")
    variants = Variants(task, taste, steps).of(options.parts)
    scorer = Scorer(task, taste, options.episodes, HORIZON)
    folder, seeds = options.out / "rlhf", range(options.seeds)
    study = PreferenceStudy(variants, seeds, scorer, folder, options.processes)
    return study.rows()


def _motion(options: Study) -> list[MotionRow]:
    rows = []
    for row in motion_rows(options.policies or default_policies(), options.episodes):
        rows.append(row)
        line = f"{row.policy}: success_held {row.success_held:.0%}"
        console().print(line, highlight=False)
    return rows


STUDIES: dict[str, tuple[Measure, Figures]] = {
    "gradients": (
        _gradients,
        lambda _: {
            "variance": gradient_figures.draw_variance,
            "bias": gradient_figures.draw_bias,
        },
    ),
    "clipping": (_clipping, lambda _: {"clipping": learning_figures.draw_clipping}),
    "asynchrony": (
        _asynchrony,
        lambda _: {"asynchrony": learning_figures.draw_algorithms},
    ),
    "algorithms": (
        _algorithms,
        lambda _: {"algorithms": learning_figures.draw_algorithms},
    ),
    "rlhf": (
        _rlhf,
        lambda options: {f"rlhf-{part}": FIGURES[part] for part in options.parts},
    ),
    "motion": (_motion, lambda _: {"motion": draw_motion}),
}
"""Study -> the function that measures its rows, and the figures of these rows."""


def _table(rows: Sequence[Any]) -> str:
    """The rows as CSV; a number that is nan is left empty."""
    text = StringIO()
    columns = [field.name for field in fields(rows[0])]
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(_plain, rows))
    return text.getvalue()


def _plain(row: Any) -> dict[str, Any]:
    return {
        name: "" if isinstance(value, float) and isnan(value) else value
        for name, value in asdict(row).items()
    }
