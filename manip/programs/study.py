"""`manip study`: what the lesson on policy gradients claims, measured on an arm."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from io import StringIO
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from manip.envs.registry import load_task
from manip.errors import at_least
from manip.files import write_text
from manip.programs import cli
from manip.studies import figures
from manip.studies.gradients import Found, measure
from manip.studies.learning import (
    Evaluated,
    algorithm_variants,
    clipping_variants,
    evaluations,
)


@dataclass(frozen=True)
class Study:
    """Run a study with several seeds; leaves a table (.csv) and a picture (.png).

    variance: noise of the gradient: REINFORCE, with a baseline, actor-critic.
    bias: noise and bias of the gradient against n of n-step returns.
    clipping: PPO's epochs with and without clipping.
    algorithms: all of them, success against control steps and wall time.
    """

    what: Annotated[
        Literal["variance", "bias", "clipping", "algorithms"], tyro.conf.Positional
    ]
    """Which study."""
    tasks: tuple[str, ...] = ("Reach",)
    """Tasks; each but `algorithms` takes the first."""
    seeds: int = 3
    """Runs of each variant, with seeds 0, 1, ..."""
    steps: int | None = None
    """Control steps of a run; as many as its recipe has unless given."""
    stages: tuple[int, ...] = (10_000, 100_000, 300_000)
    """Control steps of training after which gradients are looked at."""
    rollouts: int = 100
    """Rollouts that gradients are estimated from, one each."""
    length: int = 40
    """Control steps of such a rollout, of every world."""
    out: Path = Path("runs/study")
    """Folder of tables, pictures and runs; what is there is not run again."""


def main(arguments: Sequence[str]) -> int:
    """Run the study and say where its results lie."""
    options = cli.parse(Study, arguments, "manip study")
    for name in ("seeds", "rollouts", "length"):
        at_least(1, f"--{name}", getattr(options, name))
    for task in options.tasks:
        load_task(task)
    found = STUDIES[options.what](options)
    table, picture = (options.out / f"{options.what}.{end}" for end in ("csv", "png"))
    write_text(table, _table(found))
    _draw(options, found, picture)
    Console().print(f"{table}\n{picture}", highlight=False)
    return 0


def _gradients(options: Study) -> list[Found]:
    return [
        row
        for seed in range(options.seeds)
        for row in measure(
            options.tasks[0], seed, options.stages, options.rollouts, options.length
        )
    ]


def _clipping(options: Study) -> list[Evaluated]:
    variants = clipping_variants(options.tasks[0], options.steps)
    return list(evaluations(variants, range(options.seeds), options.out / "runs"))


def _algorithms(options: Study) -> list[Evaluated]:
    runs = (
        evaluations(
            algorithm_variants(task, options.steps),
            range(options.seeds),
            options.out / "runs",
        )
        for task in options.tasks
    )
    return list(chain.from_iterable(runs))


STUDIES: dict[str, Callable[[Study], list[Any]]] = {
    "variance": _gradients,
    "bias": _gradients,
    "clipping": _clipping,
    "algorithms": _algorithms,
}


def _draw(options: Study, found: list[Any], path: Path) -> None:
    if options.what == "algorithms":
        figures.draw_algorithms(found, path)
        return
    draw = getattr(figures, f"draw_{options.what}")
    draw(found, options.tasks[0], path)


def _table(found: Sequence[Any]) -> str:
    text = StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(found[0])])
    writer.writeheader()
    writer.writerows(asdict(row) for row in found)
    return text.getvalue()
