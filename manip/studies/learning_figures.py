"""Figures of learning curves: lines are means over seeds, bands their range."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from manip.studies.learning import Evaluation
from manip.studies.plotting import save

Value = Callable[[Evaluation], float]


def draw_clipping(rows: Sequence[Evaluation], path: Path) -> None:
    """Draw success and KL against control steps; colours are numbers of epochs."""
    figure, panels = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
    for axes in panels:
        axes.set_prop_cycle(color=["tab:blue", "tab:orange", "tab:green"])
    for variant, curve in _by_variant(rows).items():
        style = "--" if "no clip" in variant else "-"
        _line(panels[0], curve, _thousands, _percent, variant, style)
        _line(panels[1], curve, _thousands, lambda row: row.kl, variant, style)
    panels[0].set(ylabel="success_held [%]", ylim=(-3, 103))
    panels[1].set(ylabel="KL divergence of an update", yscale="log")
    for axes in panels:
        axes.set(xlabel="control steps [thousand]")
    figure.suptitle(f"PPO's epochs with and without clipping, {rows[0].task}")
    save(figure, list(panels), path)


def draw_algorithms(rows: Sequence[Evaluation], path: Path) -> None:
    """Draw success against control steps and computing time, one row per task."""
    tasks = list(dict.fromkeys(row.task for row in rows))
    size = (11, 4.5 * len(tasks))
    figure, grid = plt.subplots(
        len(tasks), 2, figsize=size, layout="constrained", squeeze=False
    )
    for pair, task in zip(grid, tasks, strict=True):
        _draw_task(pair[0], pair[1], [row for row in rows if row.task == task])
    save(figure, [axes for pair in grid for axes in pair], path)


def _draw_task(by_steps: Axes, by_time: Axes, rows: Sequence[Evaluation]) -> None:
    for algo, curve in _by_variant(rows).items():
        _line(by_steps, curve, _thousands, _percent, algo)
        _line(by_time, curve, lambda row: row.cpu_seconds, _percent, algo)
    by_steps.set(xlabel="control steps [thousand]")
    by_time.set(xlabel="computing time [CPU s]")
    for axes in (by_steps, by_time):
        axes.set(title=rows[0].task, ylabel="success_held [%]", ylim=(-3, 103))
        axes.set_xscale("log")


def _by_variant(rows: Sequence[Evaluation]) -> dict[str, list[Evaluation]]:
    variants = dict.fromkeys(row.variant for row in rows)
    return {name: [row for row in rows if row.variant == name] for name in variants}


def _thousands(row: Evaluation) -> float:
    return row.env_steps / 1000


def _percent(row: Evaluation) -> float:
    return 100 * row.success_held


def _line(
    axes: Axes,
    rows: Sequence[Evaluation],
    x: Value,
    y: Value,
    label: str,
    style: str = "-",
) -> None:
    """Draw mean and range over seeds; the k-th evaluations of all seeds are a point."""
    seeds = [[r for r in rows if r.seed == s] for s in sorted({r.seed for r in rows})]
    points = list(zip(*seeds, strict=False))
    across = np.array([np.mean([x(row) for row in point]) for point in points])
    values = np.array([[y(row) for row in point] for point in points])
    (line,) = axes.plot(across, values.mean(1), style, marker="o", ms=3, label=label)
    low, high, color = values.min(1), values.max(1), line.get_color()
    axes.fill_between(across, low, high, color=color, alpha=0.15, lw=0)
