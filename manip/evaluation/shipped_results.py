"""The shipped results: success of each recipe in stock robosuite, by training seed."""

from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from manip.errors import UserError, one_line
from manip.evaluation.statistics import (
    Rate,
    SeedCount,
    rate_over_seeds,
    wilson_rate,
)
from manip.io.atomic_files import write_text
from manip.io.yaml_files import read_yaml

RESULTS = Path(str(files("manip.assets"))) / "results.yaml"

Key = tuple[str, str, str]
"""Task, robot, algorithm."""


@dataclass(frozen=True)
class Run:
    """Result of one training seed.

    Attributes:
        success_held: evaluation episodes with success_held, in stock robosuite.
        episodes: evaluation episodes.
        env_steps: control steps of training.
        minutes: wall time of training and its evaluations; None if not measured.
        choice_rate: rate of success_held in the native episodes by which the seed of
            the shipped policy is chosen, which are not the evaluation episodes; None
            if not measured.
    """

    seed: int
    success_held: int
    episodes: int
    env_steps: int
    minutes: float | None
    choice_rate: float | None = None

    @property
    def count(self) -> SeedCount:
        """Successful episodes and episodes."""
        return SeedCount(self.success_held, self.episodes)

    @property
    def rate(self) -> Rate:
        """Rate of success_held; the Wilson interval covers episodes only."""
        return wilson_rate(*self.count)

    def to_dict(self) -> dict[str, Any]:
        """Plain values; without `choice_rate` if it was not measured."""
        values = asdict(self)
        return {k: v for k, v in values.items() if (k, v) != ("choice_rate", None)}


@dataclass(frozen=True)
class Result:
    """Results of a recipe on one machine, seed by seed.

    Attributes:
        algo: algorithm and observation, as recipes are named: bc, bc-cameras.
    """

    task: str
    robot: str
    algo: str
    demonstrations: bool
    machine: str
    runs: tuple[Run, ...]

    @property
    def key(self) -> Key:
        """Task, robot, algorithm."""
        return self.task, self.robot, self.algo

    @property
    def counts(self) -> list[SeedCount]:
        """Successful episodes and episodes of each seed."""
        return [run.count for run in self.runs]

    @property
    def rate(self) -> Rate:
        """Mean rate of success_held; the interval covers seeds and episodes.

        With one seed it covers episodes only.
        """
        return rate_over_seeds(self.counts)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for YAML and JSON."""
        return asdict(self) | {"runs": [run.to_dict() for run in self.runs]}


@dataclass(frozen=True)
class Results:
    """All results, and robosuite's published baseline.

    Attributes:
        robosuite_benchmark: task -> robot -> result of the SAC baseline that was
            published with robosuite.
    """

    robosuite_benchmark: dict[str, dict[str, str]]
    results: tuple[Result, ...]

    def of(self, key: Key) -> Result | None:
        """The result of a recipe, if there is one."""
        return next((result for result in self.results if result.key == key), None)

    def run(self, key: Key, seed: int) -> Run | None:
        """The run of a recipe with a seed, if there is one."""
        result = self.of(key)
        runs = result.runs if result else ()
        return next((run for run in runs if run.seed == seed), None)

    def having(self, result: Result) -> "Results":
        """A copy with one result added or replaced."""
        others = [old for old in self.results if old.key != result.key]
        ordered = sorted([*others, result], key=lambda r: r.key)
        return Results(self.robosuite_benchmark, tuple(ordered))

    def save(self, path: Path = RESULTS) -> None:
        """Write the file atomically."""
        plain = {
            "robosuite_benchmark": self.robosuite_benchmark,
            "results": [result.to_dict() for result in self.results],
        }
        write_text(path, yaml.safe_dump(plain, sort_keys=False, width=120))


def load_results(path: Path = RESULTS) -> Results:
    """Read the results.

    Raises:
        UserError: the file is damaged.
    """
    try:
        plain = read_yaml(path)
        results = tuple(map(_result, plain["results"]))
        return Results(plain["robosuite_benchmark"], results)
    except (KeyError, TypeError) as error:
        raise UserError(f"{path} is damaged: {one_line(error)}") from error


def _result(values: dict[str, Any]) -> Result:
    return Result(**values | {"runs": tuple(Run(**run) for run in values["runs"])})
