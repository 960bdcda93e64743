"""Summary of a sweep: aggregates of each variant, and comparisons of variants."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from manip.cluster.sweep_results import ScoredRun
from manip.evaluation.aggregates import (
    Array,
    Estimate,
    estimate,
    improvement,
    interquartile_mean,
    mean,
)
from manip.io.atomic_files import write_text
from manip.io.csv_text import csv_text

ALL_TASKS = "all tasks"


@dataclass(frozen=True)
class Aggregate:
    """Success of a variant on one task, or on all of them together.

    Attributes:
        variant: the algorithm and the options that differ.
        task: or `ALL_TASKS`.
        runs: their number, over seeds and tasks.
        mean, iqm: mean and interquartile mean of the success rates of the runs.
    """

    variant: str
    task: str
    runs: int
    mean: Estimate
    iqm: Estimate


@dataclass(frozen=True)
class Improvement:
    """Probability that a run of `variant` succeeds more often than one of `other`."""

    variant: str
    other: str
    probability: Estimate


class Summary:
    """Aggregates and comparisons of the runs of one sweep or several.

    Args:
        runs: the finished runs.
        measure: the rate that counts: success_once, success_at_end or success_held.

    Attributes:
        aggregates: of each variant and task, in the order of the runs.
        improvements: of all ordered pairs of variants that share a task.
        best: the variant with the highest interquartile mean over all its tasks.
    """

    def __init__(self, runs: Sequence[ScoredRun], measure: str) -> None:
        self.measure = measure
        self._scores = _scores(runs, measure)
        self.aggregates = [
            aggregate for variant in self._scores for aggregate in self._of(variant)
        ]
        self.improvements = [
            Improvement(ours, other, improvement(x, y))
            for ours, x in self._scores.items()
            for other, y in self._scores.items()
            if ours != other and x.keys() & y.keys()
        ]
        self.best = max(self._scores, key=self._iqm)

    def write(self, folder: Path) -> list[Path]:
        """Write aggregates.csv and improvement.csv; return their paths."""
        tables = {
            "aggregates.csv": [_aggregate_row(a) for a in self.aggregates],
            "improvement.csv": [_improvement_row(i) for i in self.improvements],
        }
        for name, rows in tables.items():
            columns = list(dict.fromkeys(column for row in rows for column in row))
            write_text(folder / name, csv_text(columns, rows))
        return [folder / name for name in tables]

    def table(self) -> Table:
        """The aggregates, and the comparison of each variant with the best one."""
        table = Table(title=f"{self.measure}, mean over seeds [95 % interval]")
        for column in ("variant", "task"):
            table.add_column(column)
        for column in ("runs", "mean [%]", "IQM [%]", f"P(> {self.best})"):
            table.add_column(Text(column), justify="right")
        against = {i.variant: i.probability for i in self.improvements_over_best()}
        for row in self.aggregates:
            last = against.get(row.variant) if self._is_total(row) else None
            cells = (*_cells(row), _percent(last) if last else "")
            table.add_row(*map(Text, cells))
        return table

    def improvements_over_best(self) -> list[Improvement]:
        """Comparisons of the other variants with the best one."""
        return [i for i in self.improvements if i.other == self.best]

    def _is_total(self, row: Aggregate) -> bool:
        """Whether a row is the last of its variant."""
        return [a for a in self.aggregates if a.variant == row.variant][-1] is row

    def _of(self, variant: str) -> list[Aggregate]:
        scores = self._scores[variant]
        parts = {task: {task: values} for task, values in scores.items()}
        if len(scores) > 1:
            parts[ALL_TASKS] = scores
        return [
            Aggregate(
                variant,
                task,
                sum(map(len, part.values())),
                estimate(part, mean),
                estimate(part, interquartile_mean),
            )
            for task, part in parts.items()
        ]

    def _iqm(self, variant: str) -> float:
        totals = [a for a in self.aggregates if a.variant == variant]
        return totals[-1].iqm.value


def _scores(runs: Sequence[ScoredRun], measure: str) -> dict[str, dict[str, Array]]:
    """Variant -> task -> rates [S]."""
    names = dict.fromkeys(name for run in runs for name in run.options)
    varied = [n for n in names if len({run.options.get(n, "") for run in runs}) > 1]
    lists: dict[str, dict[str, list[float]]] = {}
    for run in runs:
        tasks = lists.setdefault(_variant(run, varied), {})
        tasks.setdefault(run.task, []).append(run.success[measure])
    return {
        variant: {task: np.array(values) for task, values in tasks.items()}
        for variant, tasks in lists.items()
    }


def _variant(run: ScoredRun, varied: Sequence[str]) -> str:
    """The algorithm and the options that differ between runs, as a label."""
    options = [
        f"{name.split('.')[-1]}={run.options[name]}"
        for name in varied
        if name != "algo" and run.options.get(name)
    ]
    return " ".join([run.options["algo"], *options])


def _aggregate_row(row: Aggregate) -> dict[str, Any]:
    columns = {"variant": row.variant, "task": row.task, "runs": row.runs}
    return columns | _columns("mean", row.mean) | _columns("iqm", row.iqm)


def _improvement_row(row: Improvement) -> dict[str, Any]:
    columns = {"variant": row.variant, "other": row.other}
    return columns | _columns("probability", row.probability)


def _columns(name: str, value: Estimate) -> dict[str, Any]:
    ends = {f"{name}_low": value.low, f"{name}_high": value.high}
    return {name: value.value} | {n: "" if isnan(v) else v for n, v in ends.items()}


def _cells(row: Aggregate) -> tuple[str, ...]:
    ends = _percent(row.mean), _percent(row.iqm)
    return row.variant, row.task, str(row.runs), *ends


def _percent(value: Estimate) -> str:
    shown = f"{100 * value.value:.0f}"
    if isnan(value.low):
        return shown
    return f"{shown} [{100 * value.low:.0f}, {100 * value.high:.0f}]"
