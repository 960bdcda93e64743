"""The results that are shipped: what each recipe reaches in stock robosuite."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from statistics import median
from typing import Any

import yaml

from manip.errors import UserError
from manip.evaluation.statistics import Rate, success_rate
from manip.io.atomic_files import write_text
from manip.io.yaml_files import read_yaml

RESULTS = Path(str(files("manip.assets"))) / "results.yaml"

Key = tuple[str, str, str]
"""Task, robot, algorithm."""


@dataclass(frozen=True)
class Run:
    """What one training seed came to.

    Attributes:
        success_held: episodes with held success, of `episodes` in stock robosuite.
        env_steps: control steps of training.
        minutes: wall time of training and its evaluations on the way; None where it
            was not taken.
    """

    seed: int
    success_held: int
    episodes: int
    env_steps: int
    minutes: float | None

    @property
    def rate(self) -> Rate:
        """Rate of held success, with its Wilson 95 % interval."""
        return success_rate([e < self.success_held for e in range(self.episodes)])


@dataclass(frozen=True)
class Result:
    """What a recipe came to on one machine, seed by seed."""

    task: str
    robot: str
    algo: str
    demonstrations: bool
    machine: str
    runs: tuple[Run, ...]

    @property
    def key(self) -> Key:
        """What the recipe is for."""
        return self.task, self.robot, self.algo

    def plain(self) -> dict[str, Any]:
        """Fit for YAML and JSON."""
        return asdict(self) | {"runs": [asdict(run) for run in self.runs]}


@dataclass(frozen=True)
class Results:
    """All results, and what others published.

    Attributes:
        robosuite_benchmark: task -> robot -> what the SAC baseline published with
            robosuite reaches.
    """

    robosuite_benchmark: dict[str, dict[str, str]]
    results: tuple[Result, ...]

    def of(self, key: Key) -> Result | None:
        """The result of a recipe, if there is one."""
        return next((result for result in self.results if result.key == key), None)

    def run(self, key: Key, seed: int) -> Run | None:
        """The run of a recipe with a seed, if there is one."""
        found = self.of(key)
        runs = found.runs if found else ()
        return next((run for run in runs if run.seed == seed), None)

    def having(self, result: Result) -> "Results":
        """These, with one result added or replaced."""
        others = [old for old in self.results if old.key != result.key]
        ordered = sorted([*others, result], key=lambda r: r.key)
        return Results(self.robosuite_benchmark, tuple(ordered))

    def save(self, path: Path = RESULTS) -> None:
        """Write them, whole or not at all."""
        plain = asdict(self) | {"results": [result.plain() for result in self.results]}
        write_text(path, yaml.safe_dump(plain, sort_keys=False, width=120))


def load_results(path: Path = RESULTS) -> Results:
    """Read the results.

    Raises:
        UserError: the file is damaged.
    """
    try:
        found = read_yaml(path)
        results = tuple(map(_result, found["results"]))
        return Results(found["robosuite_benchmark"], results)
    except (yaml.YAMLError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise UserError(f"{path} is damaged: {reason}") from error


def _result(values: dict[str, Any]) -> Result:
    return Result(**values | {"runs": tuple(Run(**run) for run in values["runs"])})


HEADER = (
    *("task", "arm", "algo", "demos", "held [%]", "env steps", "minutes"),
    *("machine", "robosuite-benchmark"),
)


def rows(found: Results, results: Iterable[Result]) -> list[tuple[str, ...]]:
    """A row of text for each result, under `HEADER`; medians of steps and minutes."""
    return [
        (
            *(result.task, result.robot, result.algo.upper()),
            "yes" if result.demonstrations else "no",
            ", ".join(percent(run.rate) for run in result.runs),
            f"{median(run.env_steps for run in result.runs):,.0f}",
            _median_minutes(result.runs),
            result.machine,
            found.robosuite_benchmark.get(result.task, {}).get(result.robot, ""),
        )
        for result in results
    ]


def _median_minutes(runs: Iterable[Run]) -> str:
    taken = [run.minutes for run in runs if run.minutes is not None]
    return f"{median(taken):.1f}" if taken else ""


def percent(rate: Rate) -> str:
    """A rate and its interval: 97 (92-99)."""
    return f"{100 * rate.rate:.0f} ({100 * rate.low:.0f}-{100 * rate.high:.0f})"


def markdown(found: Results) -> str:
    """The table of all results in Markdown."""
    lines: list[Sequence[str]] = [HEADER, ("---",) * len(HEADER)]
    lines += rows(found, found.results)
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)
