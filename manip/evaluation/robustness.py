"""Robustness: success under perturbations of growing strength."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rich.table import Table
from rich.text import Text

from manip.envs.external_task import simulator_of
from manip.errors import UserError, one_line
from manip.evaluation.episodes import Episode
from manip.evaluation.report import SUCCESS, EvaluatedPolicy, summarise
from manip.evaluation.results_table import percent
from manip.evaluation.runners import EpisodeSettings
from manip.evaluation.statistics import Rate
from manip.evaluation.stress_suite import Stress
from manip.io.csv_text import csv_text
from manip.io.printable import printable


@dataclass(frozen=True)
class Level:
    """Results at one strength.

    Attributes:
        value: of the quantity, or its standard deviation.
        success: success_once, success_at_end, success_held -> rate, Wilson interval.
        return_mean: mean return.
    """

    value: float
    success: dict[str, Rate]
    return_mean: float


@dataclass(frozen=True)
class PerturbedResult:
    """Results of one perturbation, the weakest level first."""

    name: str
    quantity: str
    unit: str
    levels: tuple[Level, ...]


@dataclass(frozen=True)
class Robustness(EvaluatedPolicy):
    """Success of a policy under a suite of perturbations.

    Each level has the same episodes as the nominal ones, but for what it perturbs.

    Attributes:
        nominal: results without perturbation.
        left_out: perturbation -> why it does not apply here.
        seconds: wall time.
    """

    nominal: Level
    perturbed: tuple[PerturbedResult, ...]
    left_out: dict[str, str]
    seconds: float
    versions: dict[str, str]

    def to_csv(self) -> str:
        """A row for each level; the nominal one first, with strength 0."""
        rows = [{"perturbation": "nominal", "strength": 0, **_columns(self.nominal)}]
        for each in self.perturbed:
            names = {"perturbation": each.name, "quantity": each.quantity}
            names |= {"unit": each.unit}
            rows += [
                {**names, "strength": strength, **_columns(level)}
                for strength, level in enumerate(each.levels, start=1)
            ]
        columns = ["perturbation", "quantity", "unit", *list(rows[0])[1:]]
        return csv_text(columns, rows)


def _columns(level: Level) -> dict[str, Any]:
    row: dict[str, Any] = {"value": level.value}
    for measure in SUCCESS:
        rate = level.success[measure]
        row |= {measure: rate.rate, f"{measure}_low": rate.low}
        row |= {f"{measure}_high": rate.high}
    return row | {"return": level.return_mean}


Run = Callable[[EpisodeSettings], Sequence[Episode]]
"""Runs the episodes of some settings."""


def run_suite(
    run: Run, settings: EpisodeSettings, suite: Mapping[str, Stress]
) -> tuple[Level, tuple[PerturbedResult, ...], dict[str, str]]:
    """Run the nominal episodes and those of each perturbation.

    Returns:
        The nominal level, the perturbations that apply, and why others do not.

    Raises:
        UserError: the settings do not fit the policy.
    """
    nominal = _level(0.0, run(settings))
    results, left_out = [], {}
    for name, stress in suite.items():
        try:
            levels = tuple(_levels(run, settings, stress))
        except UserError as error:
            left_out[name] = one_line(error)
            continue
        unit = f"std {stress.unit}" if stress.spread == "normal" else stress.unit
        results.append(PerturbedResult(name, stress.subject, unit, levels))
    return nominal, tuple(results), left_out


def _levels(run: Run, settings: EpisodeSettings, stress: Stress) -> Iterator[Level]:
    for value in stress.levels:
        if stress.looks:
            if settings.cameras is None:
                raise UserError("the policy sees no images")
            changed = replace(settings, looks=stress.look(value))
        else:
            changed = replace(settings, perturbations=(stress.perturbation(value),))
        yield _level(value, run(changed))


def _level(value: float, episodes: Sequence[Episode]) -> Level:
    names = [str(index) for index, _ in enumerate(episodes[0].milestones)]
    summary = summarise(episodes, names)
    return Level(float(value), summary["success"], summary["return_mean"])


def robustness_table(result: Robustness) -> Table:
    """success_held [%] of each level with its 95 % interval."""
    nominal = percent(result.nominal.success["success_held"])
    simulator = simulator_of(result.env, result.task)
    title = f"{result.task} · {result.robot} · {result.algo} · {simulator}"
    table = Table(title=Text(printable(f"{title}: nominal {nominal}"), style="bold"))
    most = max((len(each.levels) for each in result.perturbed), default=0)
    strengths = [f"strength {1 + index}" for index in range(most)]
    for column in ("perturbation", "levels", *strengths):
        table.add_column(column)
    for each in result.perturbed:
        values = ", ".join(f"{level.value:g}" for level in each.levels)
        rates = [percent(level.success["success_held"]) for level in each.levels]
        _add(table, each.name, f"{values} {each.unit}", *rates)
    for name, reason in result.left_out.items():
        _add(table, name, f"left out: {reason}")
    return table


def _add(table: Table, *cells: str) -> None:
    table.add_row(*(Text(printable(cell)) for cell in cells))
