"""Plot the learning curve of a run."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from manip.io.atomic_files import replace_file

CURVES = {
    "success_once": "-",
    "success_held": "-",
    "success_at_end": ":",
}
"""Measure of success -> line style; the columns of metrics.csv are eval/NAME."""


def plot_learning_curve(
    rows: Sequence[Mapping[str, str]], title: str, path: Path
) -> None:
    """Draw success and return against control steps, with wall time along the top.

    Args:
        rows: rows of metrics.csv; those without an evaluation are left out.
        title: title of the figure.
        path: .png file to write.
    """
    rows = [row for row in rows if row.get("eval/success_held")]
    steps = _column(rows, "env_steps") / 1000
    figure = Figure(figsize=(7, 6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for measure, style in CURVES.items():
        success = 100 * _column(rows, f"eval/{measure}")
        upper.plot(steps, success, style, marker="o", label=measure)
    upper.set(ylabel="success [%]", ylim=(-3, 103))
    upper.legend(title="evaluation", loc="lower right")
    lower.plot(steps, _column(rows, "eval/return"), color="black", marker="o")
    lower.set(ylabel="mean return", xlabel="control steps [thousand]")
    _mark_time(upper, steps, _column(rows, "seconds"))
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    figure.suptitle(title)
    replace_file(path, lambda partial: figure.savefig(partial, dpi=120))


def _mark_time(axes: Axes, steps: np.ndarray, seconds: np.ndarray) -> None:
    """Add a second axis for wall time, extrapolated beyond the last evaluation."""
    steps, seconds = (np.r_[0, known, 2 * known[-1]] for known in (steps, seconds))

    def to_seconds(x: ArrayLike) -> np.ndarray:
        return np.interp(np.asarray(x, float), steps, seconds)

    def to_steps(x: ArrayLike) -> np.ndarray:
        return np.interp(np.asarray(x, float), seconds, steps)

    top = axes.secondary_xaxis("top", functions=(to_seconds, to_steps))
    top.set_xlabel("training time [s]")


def _column(rows: Sequence[Mapping[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name]) for row in rows])
