"""Learning curves of groups of runs: mean and range over seeds."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from manip.studies.plotting import save
from manip.studies.run_groups import MEASURE, Group, Run

Array = np.ndarray

PANELS = {
    "success_held in evaluations [%]": ((f"eval/{MEASURE}", f"curve/{MEASURE}"), 100),
    "success_held in training episodes [%]": ((f"train/{MEASURE}",), 100),
    "return of training episodes": (("train/return",), 1),
}
"""Label of a panel -> its columns, of which a row has one, and a factor."""


def draw_comparison(groups: Sequence[Group], path: Path) -> None:
    """Draw the learning curves of groups; bands are the range over seeds."""
    size = (5 * len(PANELS), 4.5)
    figure, panels = plt.subplots(1, len(PANELS), figsize=size, layout="constrained")
    for axes, (label, (columns, factor)) in zip(panels, PANELS.items(), strict=True):
        for place, group in enumerate(groups):
            _draw(axes, group, columns, factor, f"C{place % 10}")
        axes.set(xlabel="control steps [thousand]", ylabel=label)
        axes.set_xlim(left=0)
        if "%" in label:
            axes.set_ylim(-3, 103)
    figure.suptitle("learning curves: mean and range over training seeds")
    save(figure, list(panels), path)


def _draw(
    axes: Axes, group: Group, columns: Sequence[str], factor: float, color: str
) -> None:
    seeds = f", {len(group.runs)} seeds" if len(group.runs) > 1 else ""
    steps, values = curve(group.runs, columns)
    marker = "o" if len(steps) < 30 else ""
    axes.plot(
        *(steps / 1000, factor * values.mean(0)),
        color=color,
        marker=marker,
        ms=3,
        label=group.name + seeds,
    )
    low, high = factor * values.min(0), factor * values.max(0)
    axes.fill_between(steps / 1000, low, high, color=color, alpha=0.2, lw=0)


def curve(runs: Sequence[Run], columns: Sequence[str]) -> tuple[Array, Array]:
    """Control steps [T] and values [S, T] of the runs that have such columns.

    The steps are those of all runs together; between its own rows, a run's value is
    interpolated. Where a run has no rows yet or any more, the curve ends.
    """
    points = [_points(run, columns) for run in runs]
    points = [(steps, values) for steps, values in points if len(steps)]
    if not points:
        return np.zeros(0), np.zeros((1, 0))
    first = max(steps[0] for steps, _ in points)
    last = min(steps[-1] for steps, _ in points)
    grid = np.unique(np.concatenate([steps for steps, _ in points]))
    grid = grid[(first <= grid) & (grid <= last)]
    return grid, np.stack([np.interp(grid, *point) for point in points])


def _points(run: Run, columns: Sequence[str]) -> tuple[Array, Array]:
    """Control steps and values of a run's rows that have one of the columns."""
    pairs = [
        (row["env_steps"], row[column])
        for row in run.rows
        for column in columns
        if column in row
    ]
    steps, values = np.array(pairs).reshape(-1, 2).T
    return steps, values
