"""Contests: all contestants take turns in one run, round after round.

The median of the rounds counts, and a ratio is the median of the ratios of each
round, so that a machine's ups and downs hit all contestants alike.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from manip.cpus import usable_cpus
from manip.io.atomic_files import write_text
from manip.versions import versions

Contestant = Callable[[], float]
"""Runs for a moment; returns what is measured: control steps a second, or seconds."""


@dataclass(frozen=True)
class Settings:
    """What all benchmarks are asked for."""

    task: str = "Lift"
    worlds: int = 64
    rounds: int = 7


@dataclass(frozen=True)
class Contest:
    """What is measured.

    contestants: by name, in the order of their turns; all measure in `unit`.
    ratios: figure -> (contestant over, contestant under).
    medians: figure -> contestant; facts: figure -> number that needs no rounds.
    derive: further figures from all rounds.
    """

    title: str
    contestants: dict[str, Contestant]
    ratios: dict[str, tuple[str, str]] = field(default_factory=dict)
    medians: dict[str, str] = field(default_factory=dict)
    facts: dict[str, float] = field(default_factory=dict)
    unit: str = "control steps/s"
    warm_up: bool = True
    derive: Callable[[dict[str, list[float]]], dict[str, float]] | None = None


@dataclass(frozen=True)
class Outcome:
    """What was found: contestant -> a number for each round, and the figures."""

    contest: Contest
    rounds: dict[str, list[float]]

    def figures(self) -> dict[str, float]:
        """Figure -> value, flat."""
        ratios = {
            figure: float(np.median(np.divide(self.rounds[over], self.rounds[under])))
            for figure, (over, under) in self.contest.ratios.items()
        }
        medians = {
            figure: float(np.median(self.rounds[name]))
            for figure, name in self.contest.medians.items()
        }
        derive = self.contest.derive
        derived = derive(self.rounds) if derive else {}
        return ratios | medians | derived | self.contest.facts


def hold(contest: Contest, rounds: int) -> Outcome:
    """Let all contestants take turns; a first turn of each only warms up."""
    if contest.warm_up:
        for go in contest.contestants.values():
            go()
    found: dict[str, list[float]] = {name: [] for name in contest.contestants}
    for _ in range(rounds):
        for name, go in contest.contestants.items():
            found[name].append(go())
    return Outcome(contest, found)


def speed(go: Callable[[], int]) -> Contestant:
    """Measures the control steps a second of a function that returns its steps."""

    def timed() -> float:
        began = time.perf_counter()
        steps = go()
        return steps / (time.perf_counter() - began)

    return timed


def show(outcome: Outcome) -> None:
    """Print the table and the figures."""
    console, contest = Console(), outcome.contest
    table = Table(title=contest.title)
    table.add_column("contestant")
    for column in (contest.unit, "lowest", "highest"):
        table.add_column(column, justify="right")
    for name, found in outcome.rounds.items():
        values = (float(np.median(found)), min(found), max(found))
        table.add_row(name, *map(_readable, values))
    console.print(table)
    for name, figure in outcome.figures().items():
        text = f"{name.replace('_', ' ')}: {_readable(figure)}"
        console.print(text, highlight=False)


def save(outcome: Outcome, settings: Settings, path: Path) -> None:
    """Write figures, medians, spreads and rounds as JSON."""
    spreads = {
        name: {
            "median": float(np.median(found)),
            "lowest": min(found),
            "highest": max(found),
            "rounds": found,
        }
        for name, found in outcome.rounds.items()
    }
    record = {
        "title": outcome.contest.title,
        "unit": outcome.contest.unit,
        "figures": outcome.figures(),
        "contestants": spreads,
        "task": settings.task,
        "worlds": settings.worlds,
        "rounds": settings.rounds,
        "cpus": usable_cpus(),
        "versions": versions(),
    }
    write_text(path, json.dumps(record, indent=2) + "\n")


def _readable(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
