"""Results in a run's folder that other programs wrote: eval.json, robustness.json."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from manip.errors import UserError, one_line
from manip.evaluation.statistics import Rate

EVALUATION, ROBUSTNESS = "eval.json", "robustness.json"
"""What `manip evaluate RUN --out RUN` writes, the latter with --perturb."""

Result = TypeVar("Result")


@dataclass(frozen=True)
class StoredEvaluation:
    """success_held in other episodes, for example in stock robosuite."""

    env: str
    episodes: int
    seed: int
    success_held: Rate


@dataclass(frozen=True)
class PerturbedRow:
    """A perturbation: success_held at each strength, the weakest first."""

    name: str
    unit: str
    levels: tuple[tuple[float, Rate], ...]


@dataclass(frozen=True)
class StoredRobustness:
    """Success under perturbations of growing strength, and without any."""

    env: str
    episodes: int
    nominal: Rate
    rows: tuple[PerturbedRow, ...]

    @property
    def most_levels(self) -> int:
        """Largest number of strengths of a perturbation."""
        return max((len(row.levels) for row in self.rows), default=0)


def stored_evaluation(run: Path) -> StoredEvaluation | None:
    """The evaluation in a run's folder; None if there is none.

    Raises:
        UserError: the file is damaged.
    """
    return _read(run / EVALUATION, _evaluation)


def stored_robustness(run: Path) -> StoredRobustness | None:
    """The results under perturbations in a run's folder; None if there are none.

    Raises:
        UserError: the file is damaged.
    """
    return _read(run / ROBUSTNESS, _robustness)


def _read(path: Path, build: Callable[[Any], Result]) -> Result | None:
    if not path.is_file():
        return None
    try:
        return build(json.loads(path.read_text(encoding="utf-8")))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{path} holds no results that can be shown ({one_line(error)}): make it "
            "again with manip evaluate, or remove it"
        ) from error


def _evaluation(values: Mapping[str, Any]) -> StoredEvaluation:
    counts = int(values["episodes"]), int(values["seed"])
    return StoredEvaluation(str(values["env"]), *counts, _held(values))


def _robustness(values: Mapping[str, Any]) -> StoredRobustness:
    rows = tuple(
        PerturbedRow(
            str(row["name"]),
            str(row["unit"]),
            tuple((float(level["value"]), _held(level)) for level in row["levels"]),
        )
        for row in values["perturbed"]
    )
    episodes = int(values["episodes"])
    return StoredRobustness(
        str(values["env"]), episodes, _held(values["nominal"]), rows
    )


def _held(values: Mapping[str, Any]) -> Rate:
    """The rate of success_held, in [0, 1]."""
    rate = values["success"]["success_held"]
    numbers = [float(rate[name]) for name in ("rate", "low", "high")]
    if not all(0 <= number <= 1 for number in numbers):
        raise ValueError(f"a rate is not from 0 to 1: {numbers}")
    return Rate(*numbers)
