"""Plot the learning curve of a run."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from manip.io.atomic_files import replace_file

Row = Mapping[str, float]
"""A row of metrics.csv: column -> number."""

COLORS = {
    "success_once": "tab:green",
    "success_at_end": "tab:orange",
    "success_held": "tab:blue",
}
"""Measure of success -> color; the columns of metrics.csv are KIND/NAME."""

STYLES: dict[str, dict[str, Any]] = {
    "train": {"lw": 1, "alpha": 0.6},
    "curve": {"ls": "", "marker": "o", "mfc": "none"},
    "eval": {"ls": "", "marker": "o"},
}
"""Kind of rates -> how it is drawn."""

LEGEND = {
    "train": "training episodes",
    "curve": "light evaluation",
    "eval": "evaluation",
}


def plot_learning_curve(rows: Sequence[Row], title: str, path: Path) -> None:
    """Draw success, milestones and return against control steps, and wall time on top.

    Args:
        rows: rows of metrics.csv, each with the columns that it has a value for.
        title: title of the figure.
        path: .png file to write.
    """
    figure = Figure(figsize=(7, 8))
    panels = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
    _draw_success(panels[0], rows)
    _draw_milestones(panels[1], rows)
    for kind in STYLES:
        _draw(panels[2], rows, f"{kind}/return", 1, "black", STYLES[kind])
    panels[2].set(ylabel="mean return", xlabel="control steps [thousand]")
    panels[0].set_xlim(left=0)
    if rows:
        _mark_time(panels[0], rows)
    for axes in panels:
        axes.grid(alpha=0.3)
    figure.suptitle(title)
    figure.subplots_adjust(0.1, 0.07, 0.97, 0.88, hspace=0.08)
    replace_file(path, lambda partial: figure.savefig(partial, dpi=100))


def _draw_success(axes: Axes, rows: Sequence[Row]) -> None:
    for name, color in COLORS.items():
        axes.plot([], [], color=color, label=name)
        for kind, style in STYLES.items():
            _draw(axes, rows, f"{kind}/{name}", 100, color, style)
    for kind, style in STYLES.items():
        axes.plot([], [], color="gray", label=LEGEND[kind], **style)
    axes.set(ylabel="success [%]", ylim=(-3, 103))
    axes.legend(fontsize="small")


def _draw_milestones(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the rates of the milestones in training, or in evaluations without these."""
    kind = "train" if any("train/success_at_end" in row for row in rows) else "eval"
    names = dict.fromkeys(name.partition("/") for row in rows for name in row)
    shown = [name for group, _, name in names if group == kind and "/" not in name]
    milestones = [name for name in shown if name not in ("return", *COLORS)]
    for place, name in enumerate(milestones):
        _draw(axes, rows, f"{kind}/{name}", 100, f"C{place % 10}", {"label": name})
    axes.set(ylabel="milestone reached [%]", ylim=(-3, 103))
    if milestones:
        axes.legend(fontsize="small", title=LEGEND[kind])


def _draw(
    axes: Axes,
    rows: Sequence[Row],
    column: str,
    factor: float,
    color: str,
    style: Mapping[str, Any],
) -> None:
    points = [(row["env_steps"], row[column]) for row in rows if column in row]
    if points:
        steps, values = np.array(points).T
        axes.plot(steps / 1000, factor * values, color=color, **style)


def _mark_time(axes: Axes, rows: Sequence[Row]) -> None:
    """Add a second axis for wall time, extrapolated beyond the last row."""
    known = np.array([(row["env_steps"] / 1000, row["seconds"]) for row in rows]).T
    steps, seconds = (np.r_[0, values, 2 * values[-1]] for values in known)

    def to_seconds(x: ArrayLike) -> np.ndarray:
        return np.interp(np.asarray(x, float), steps, seconds)

    def to_steps(x: ArrayLike) -> np.ndarray:
        return np.interp(np.asarray(x, float), seconds, steps)

    top = axes.secondary_xaxis("top", functions=(to_seconds, to_steps))
    top.set_xlabel("training time [s]")
