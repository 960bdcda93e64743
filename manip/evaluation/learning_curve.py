"""A run's learning curve as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from manip.io.atomic_files import replace_file

CURVES = {
    "eval/success_once": ("ever", "-"),
    "eval/success_held": ("success_held", "-"),
    "eval/success_at_end": ("at the end", ":"),
}
"""Column of metrics.csv -> its name and line style in the picture."""


def plot_learning_curve(
    rows: Sequence[Mapping[str, str]], title: str, path: Path
) -> None:
    """Draw success and return against control steps, with wall time on top.

    Args:
        rows: of metrics.csv; those without an evaluation are passed over.
        title: over the picture.
        path: a .png file.
    """
    rows = [row for row in rows if row.get("eval/success_held")]
    steps = _column(rows, "env_steps") / 1000
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(7, 6), sharex=True, height_ratios=(3, 2), layout="constrained"
    )
    for name, (label, style) in CURVES.items():
        upper.plot(steps, 100 * _column(rows, name), style, marker="o", label=label)
    upper.set(ylabel="success [%]", ylim=(-3, 103))
    upper.legend(title="evaluation", loc="lower right")
    lower.plot(steps, _column(rows, "eval/return"), color="black", marker="o")
    lower.set(ylabel="mean return", xlabel="control steps [thousand]")
    _mark_time(upper, steps, _column(rows, "seconds"))
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    figure.suptitle(title)
    replace_file(path, lambda temporary: figure.savefig(temporary, dpi=120))
    plt.close(figure)


def _mark_time(axes: Axes, steps: np.ndarray, seconds: np.ndarray) -> None:
    """Wall time of training as a second axis along the top, going on beyond its end."""
    steps, seconds = (np.r_[0, known, 2 * known[-1]] for known in (steps, seconds))

    def to_seconds(x: ArrayLike) -> np.ndarray:
        return np.interp(np.asarray(x, float), steps, seconds)

    def to_steps(x: ArrayLike) -> np.ndarray:
        return np.interp(np.asarray(x, float), seconds, steps)

    top = axes.secondary_xaxis("top", functions=(to_seconds, to_steps))
    top.set_xlabel("training time [s]")


def _column(rows: Sequence[Mapping[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name]) for row in rows])
