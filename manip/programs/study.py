"""`manip study`: what the lesson on policy gradients claims, measured on an arm."""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from io import StringIO
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from manip.agents.registry import algorithm_names
from manip.envs.task_registry import load_task
from manip.errors import UserError, at_least
from manip.io.atomic_files import write_text
from manip.programs import cli
from manip.studies import figures
from manip.studies.gradients import Found, measure
from manip.studies.learning import (
    Evaluated,
    algorithm_variants,
    clipping_variants,
    evaluations,
)

Measured = Callable[["Study"], list[Any]]
Pictures = Mapping[str, Callable[[Sequence[Any], Path], None]]


@dataclass(frozen=True)
class Study:
    """Run a study with several seeds; leaves a table (.csv) and a picture (.png).

    gradients: their noise (REINFORCE, with a baseline, actor-critic), and noise and
    bias against n of n-step returns: variance.png and bias.png.

    clipping: PPO's epochs with and without clipping.

    algorithms: all of them, success against control steps and computing time.
    """

    what: Annotated[
        Literal["gradients", "clipping", "algorithms"], tyro.conf.Positional
    ]
    """Which study."""
    tasks: tuple[str, ...] = ("Reach",)
    """Tasks; each but `algorithms` takes the first."""
    algos: tuple[str, ...] = tuple(algo for algo in algorithm_names() if algo != "bc")
    """What `algorithms` compares; all that learn from rewards unless given."""
    seeds: int = 3
    """Runs of each variant, with seeds 0, 1, ..."""
    steps: int | None = None
    """Control steps of a run; as many as its recipe has unless given."""
    stages: tuple[int, ...] = (5_000, 20_000, 80_000)
    """Control steps of training after which gradients are looked at."""
    gamma: float = 0.97
    """Discount of the gradients that are looked at."""
    rollouts: int = 60
    """Rollouts that gradients are estimated from, one each."""
    length: int = 40
    """Control steps at the beginning of their episodes that gradients are taken of."""
    out: Path = Path("runs/study")
    """Folder of tables, pictures and runs; runs that are there are not run again."""


def main(arguments: Sequence[str]) -> int:
    """Run the study and say where its results lie."""
    options = cli.parse(Study, arguments, "manip study")
    _check(options)
    options.out.mkdir(parents=True, exist_ok=True)
    measured, pictures = STUDIES[options.what]
    found = measured(options)
    table = options.out / f"{options.what}.csv"
    write_text(table, _table(found))
    Console().print(str(table), highlight=False)
    for name, draw in pictures.items():
        picture = options.out / f"{name}.png"
        draw(found, picture)
        Console().print(str(picture), highlight=False)
    return 0


def _check(options: Study) -> None:
    for name in ("seeds", "length"):
        at_least(1, f"--{name}", getattr(options, name))
    at_least(2, "--rollouts", options.rollouts)
    if options.steps is not None:
        at_least(1, "--steps", options.steps)
    for name in ("tasks", "algos", "stages"):
        if not getattr(options, name):
            raise UserError(f"--{name} must name at least one")
    for task in options.tasks:
        load_task(task)


def _gradients(options: Study) -> list[Found]:
    task, found = options.tasks[0], []
    for seed in range(options.seeds):
        for stage in measure(
            task, seed, options.gamma, options.stages, options.rollouts, options.length
        ):
            found += stage
            told = f"seed {seed}: {options.rollouts} gradients after"
            Console().print(f"{told} {stage[0].env_steps:,} steps", highlight=False)
    return found


def _clipping(options: Study) -> list[Evaluated]:
    variants = clipping_variants(options.tasks[0], options.steps)
    return list(evaluations(variants, range(options.seeds), options.out / "runs"))


def _algorithms(options: Study) -> list[Evaluated]:
    runs = (
        evaluations(
            algorithm_variants(task, options.algos, options.steps),
            range(options.seeds),
            options.out / "runs",
        )
        for task in options.tasks
    )
    return list(chain.from_iterable(runs))


STUDIES: dict[str, tuple[Measured, Pictures]] = {
    "gradients": (
        _gradients,
        {"variance": figures.draw_variance, "bias": figures.draw_bias},
    ),
    "clipping": (_clipping, {"clipping": figures.draw_clipping}),
    "algorithms": (_algorithms, {"algorithms": figures.draw_algorithms}),
}


def _table(found: Sequence[Any]) -> str:
    text = StringIO()
    columns = [field.name for field in fields(found[0])]
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in found)
    return text.getvalue()
