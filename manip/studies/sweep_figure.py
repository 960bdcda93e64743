"""The figure of a sweep: interquartile means, and probabilities of improvement."""

from collections.abc import Sequence
from math import ceil, isnan
from pathlib import Path
from typing import Any

from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from manip.cluster.sweep_summary import Aggregate, Summary
from manip.evaluation.aggregates import Estimate
from manip.io.atomic_files import replace_file

PER_ROW = 4
"""Panels side by side."""

_BAND: dict[str, Any] = {"lw": 8, "alpha": 0.4, "solid_capstyle": "butt"}
"""How an interval is drawn."""


def draw_summary(summary: Summary, path: Path) -> None:
    """Draw a panel per task (and one for all), and one of probabilities."""
    variants = list(dict.fromkeys(a.variant for a in summary.aggregates))
    tasks = list(dict.fromkeys(a.task for a in summary.aggregates))
    count = len(tasks) + (len(variants) > 1)
    rows = ceil(count / PER_ROW)
    figure, grid = plt.subplots(
        rows,
        min(count, PER_ROW),
        figsize=(3.6 * min(count, PER_ROW), rows * (1.3 + 0.35 * len(variants))),
        layout="constrained",
        squeeze=False,
    )
    panels = list(grid.flat)
    for axes, task in zip(panels, tasks, strict=False):
        _draw_task(axes, [a for a in summary.aggregates if a.task == task], variants)
    if len(variants) > 1:
        _draw_improvement(panels[len(tasks)], summary, variants)
    for place, axes in enumerate(panels):
        _label(axes, variants if place % PER_ROW == 0 else [""] * len(variants))
        axes.set_visible(place < count)
    figure.suptitle(f"{summary.measure}: IQM over seeds, mean (x), 95 % intervals")
    replace_file(path, lambda part: figure.savefig(part, dpi=120))
    plt.close(figure)


def _draw_task(axes: Axes, rows: Sequence[Aggregate], variants: Sequence[str]) -> None:
    for row in rows:
        place = variants.index(row.variant)
        _draw(axes, place, row.iqm, f"C{place % 10}")
        axes.plot(100 * row.mean.value, place, "x", color="black", ms=5)
    axes.set(title=rows[0].task, xlabel="success [%]", xlim=(-3, 103))


def _draw_improvement(axes: Axes, summary: Summary, variants: Sequence[str]) -> None:
    for row in summary.improvements_over_best():
        place = variants.index(row.variant)
        _draw(axes, place, row.probability, f"C{place % 10}")
    axes.axvline(50, color="gray", lw=1, ls="--")
    axes.set(title=f"P(better than {summary.best})", xlabel="probability [%]")
    axes.set(xlim=(-3, 103))


def _draw(axes: Axes, place: int, value: Estimate, color: str) -> None:
    """Draw a value with its interval, in percent, at a height."""
    if not isnan(value.low):
        ends = [100 * value.low, 100 * value.high]
        axes.plot(ends, [place, place], **_BAND, color=color)
    axes.plot(100 * value.value, place, "|", ms=14, mew=2, color=color)


def _label(axes: Axes, variants: Sequence[str]) -> None:
    axes.set_yticks(range(len(variants)), variants, fontsize="small")
    axes.set_ylim(len(variants) - 0.5, -0.5)
    axes.grid(axis="x", alpha=0.3)
