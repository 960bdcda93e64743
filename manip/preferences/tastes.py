"""Tastes: how a behaviour should look, as penalties on visible measures.

A simulated labeller prefers clips by the task's reward plus a taste, and
`manip evaluate --taste` measures how much of it a policy violates. The shipped ones are
the files of assets/tastes, one for each task.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from manip.errors import UserError, check_choice, one_line, shown
from manip.io.dataclass_values import build
from manip.io.option_ranges import NUMBER, POSITIVE, SIGNED, check_options
from manip.io.yaml_files import read_yaml

Array = np.ndarray

MOST_EXCESS = 3.0
"""Multiple of `full` beyond which an excess costs no more: else a single contact, with
its large acceleration, would outweigh all other steps of a clip."""

SHIPPED = Path(str(files("manip.assets"))) / "tastes"
"""Folder of the shipped tastes: a file for each task."""


@dataclass(frozen=True)
class TasteTerm:
    """A penalty on a measure beyond a threshold.

    Attributes:
        measure: its name.
        weight: the penalty of a step in which the measure exceeds the threshold by
            `full`; the penalty is proportional to the excess, up to `MOST_EXCESS`.
        above, below: the threshold; exactly one of them.
        full: see weight.
        during: measure -> least value; the penalty is 0 in all other steps.
    """

    measure: str
    weight: Annotated[float, NUMBER]
    full: Annotated[float, POSITIVE]
    above: Annotated[float | None, SIGNED] = None
    below: Annotated[float | None, SIGNED] = None
    during: dict[str, float] = field(default_factory=dict)

    def penalties(self, measures: Mapping[str, Array]) -> Array:
        """[...]: the penalty of each step; named measures [...]."""
        values = measures[self.measure]
        if self.above is not None:
            excess = values - self.above
        else:
            excess = float(self.below or 0) - values
        penalty = self.weight * np.clip(excess / self.full, 0.0, MOST_EXCESS)
        for name, least in self.during.items():
            penalty = np.where(measures[name] >= least, penalty, 0.0)
        return penalty


@dataclass(frozen=True)
class Taste:
    """How a behaviour should look.

    Attributes:
        words: the same in words, for people.
        terms: penalties that are added up.
        weight: weight of the sum beside the task's reward.
    """

    words: str
    terms: tuple[TasteTerm, ...]
    weight: float = 2.0

    @property
    def measures(self) -> set[str]:
        """Names of the measures that it depends on."""
        return {name for term in self.terms for name in (term.measure, *term.during)}

    def check(self, names: Sequence[str]) -> None:
        """Raise `UserError` unless all its measures are among these names."""
        for name in sorted(self.measures):
            check_choice("measure", name, names)

    def penalties(self, measures: Array, names: Sequence[str]) -> Array:
        """[...] >= 0: the penalty of each step.

        Args:
            measures: [..., M].
            names: of the M measures.

        Raises:
            UserError: one of its measures is missing.
        """
        self.check(names)
        named = {name: measures[..., i] for i, name in enumerate(names)}
        return np.sum([term.penalties(named) for term in self.terms], axis=0)


def taste_names(task: str) -> list[str]:
    """Names of the tastes that are shipped for a task."""
    return list(_shipped(task))


def shipped_tastes() -> list[str]:
    """`task: taste` of every taste that is shipped."""
    tasks = sorted(path.stem for path in SHIPPED.glob("*.yaml"))
    return [f"{task}: {name}" for task in tasks for name in taste_names(task)]


def load_taste(task: str, name: str) -> Taste:
    """A taste of a task.

    Args:
        task: the task's name.
        name: of a shipped taste; or of a YAML file with one taste of one's own.

    Raises:
        UserError: there is no such taste; the message lists those of the task. Or the
            file is damaged.
    """
    if name.endswith(".yaml"):
        if not Path(name).is_file():
            raise UserError(f"there is no file {name}")
        return read_taste(read_yaml(Path(name)), name)
    tastes = _shipped(task)
    if not tastes:
        raise UserError(
            f"no taste {shown(name)}: {task} has none; shipped ones are "
            f"{', '.join(shipped_tastes())}; or name a YAML file of your own"
        )
    check_choice(f"{task} taste", name, tastes)
    return read_taste(tastes[name], f"{task} taste {name}")


def read_taste(values: Any, where: str) -> Taste:
    """Build a taste from plain values.

    Raises:
        UserError: a value is impossible; `where` names their origin.
    """
    try:
        return _taste(values)
    except UserError as error:
        raise UserError(f"{where} is no taste: {one_line(error)}") from error


def _taste(values: Any) -> Taste:
    if not isinstance(values, Mapping) or not isinstance(values.get("terms"), list):
        raise UserError("it must be a mapping with words, weight and a list of terms")
    terms = tuple(_term(term) for term in values["terms"])
    if not terms:
        raise UserError("it has no terms")
    taste = build(Taste, {**values, "terms": terms})
    check_options(taste)
    return taste


def _term(values: Any) -> TasteTerm:
    term = build(TasteTerm, values)
    check_options(term)
    if (term.above is None) == (term.below is None):
        raise UserError(f"its term of {term.measure} needs either above or below")
    return term


def _shipped(task: str) -> dict[str, Any]:
    path = SHIPPED / f"{task}.yaml"
    if "/" in task or not path.is_file():
        return {}
    tastes: dict[str, Any] = read_yaml(path)
    return tastes
