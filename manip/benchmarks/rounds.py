"""Compare candidates that are measured in turns, round after round, in one run.

The median over the rounds is reported. A ratio is the median of the ratios of each
round, so that slow phases of the machine affect all candidates alike.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from manip.cpus import usable_cpus
from manip.io.atomic_files import write_text
from manip.versions import versions

Candidate = Callable[[], float]
"""Runs for about a second; returns its measurement: control steps/s, or seconds."""


@dataclass(frozen=True)
class Settings:
    """Options that all benchmarks share."""

    task: str = "Lift"
    num_envs: int = 64
    rounds: int = 7


@dataclass(frozen=True)
class Comparison:
    """Candidates, and the figures that are computed from their measurements.

    Attributes:
        title: of the table.
        candidates: name -> candidate, in the order of measurement.
        ratios: figure -> (candidate of the numerator, candidate of the denominator).
        medians: figure -> candidate.
        facts: figure -> value that needs no measurement.
        unit: of all measurements.
        warm_up: whether each candidate runs once before the first round.
        derive: rounds -> further figures.
        task: that is simulated.
    """

    title: str
    candidates: dict[str, Candidate]
    ratios: dict[str, tuple[str, str]] = field(default_factory=dict)
    medians: dict[str, str] = field(default_factory=dict)
    facts: dict[str, float] = field(default_factory=dict)
    unit: str = "control steps/s"
    warm_up: bool = True
    derive: Callable[[dict[str, list[float]]], dict[str, float]] | None = None
    task: str = ""


@dataclass(frozen=True)
class Measurements:
    """The measurements of a comparison: candidate -> one value per round."""

    comparison: Comparison
    rounds: dict[str, list[float]]

    def figures(self) -> dict[str, float]:
        """All figures of the comparison: name -> value."""
        comparison = self.comparison
        derived = comparison.derive(self.rounds) if comparison.derive else {}
        return self._ratios() | self._medians() | derived | comparison.facts

    def _ratios(self) -> dict[str, float]:
        return {
            figure: float(np.median(np.divide(self.rounds[over], self.rounds[under])))
            for figure, (over, under) in self.comparison.ratios.items()
        }

    def _medians(self) -> dict[str, float]:
        return {
            figure: float(np.median(self.rounds[name]))
            for figure, name in self.comparison.medians.items()
        }


def measure(comparison: Comparison, rounds: int) -> Measurements:
    """Measure all candidates in turns, `rounds` times each."""
    candidates = comparison.candidates
    if comparison.warm_up:
        for candidate in candidates.values():
            candidate()
    values: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(rounds):
        for name, candidate in candidates.items():
            values[name].append(candidate())
    return Measurements(comparison, values)


def speed(run: Callable[[], int]) -> Candidate:
    """Make a candidate of a function that returns the number of steps it took."""

    def measure_speed() -> float:
        start = time.perf_counter()
        steps = run()
        return steps / (time.perf_counter() - start)

    return measure_speed


def show(measurements: Measurements, console: Console) -> None:
    """Print the table and the figures."""
    console.print(_table(measurements))
    for name, figure in measurements.figures().items():
        text = f"{name.replace('_', ' ')}: {_readable(figure)}"
        console.print(text, highlight=False)


def save(measurements: Measurements, settings: Settings, path: Path) -> None:
    """Write figures, medians, spreads and rounds as JSON."""
    spreads = {name: _spread(values) for name, values in measurements.rounds.items()}
    record = {
        "title": measurements.comparison.title,
        "unit": measurements.comparison.unit,
        "figures": measurements.figures(),
        "candidates": spreads,
        "task": settings.task,
        "num_envs": settings.num_envs,
        "rounds": settings.rounds,
        "cpus": usable_cpus(),
        "versions": versions(),
    }
    write_text(path, json.dumps(record, indent=2) + "\n")


def _table(measurements: Measurements) -> Table:
    table = Table(title=measurements.comparison.title)
    table.add_column("candidate")
    for column in (measurements.comparison.unit, "minimum", "maximum"):
        table.add_column(column, justify="right")
    for name, values in measurements.rounds.items():
        row = (float(np.median(values)), min(values), max(values))
        table.add_row(name, *map(_readable, row))
    return table


def _spread(values: list[float]) -> dict[str, Any]:
    return {
        "median": float(np.median(values)),
        "minimum": min(values),
        "maximum": max(values),
        "rounds": values,
    }


def _readable(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
