"""Draw a learned reward against each number that it sees."""

from math import ceil
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes

from manip.preferences.reward_report import RewardReport
from manip.studies.plotting import plt, save

BINS = 12
"""Groups of equally many steps, by the number on the horizontal axis."""

MOST_PANELS = 24
"""Most numbers that are drawn: those with the largest slopes."""

COLUMNS = 4


@torch.no_grad()
def draw_reward(report: RewardReport, path: Path) -> None:
    """Write a picture: for each input, the learned reward of the compared steps.

    The line is the median, the band holds half of the steps.
    """
    steps = report.inputs.flatten(0, 1)
    reward = report.model.network.paid(steps).numpy()
    by_slope = sorted(report.slopes, key=lambda name: -abs(report.slopes[name]))
    names = by_slope[:MOST_PANELS]
    rows = ceil(len(names) / COLUMNS)
    size = (3.2 * COLUMNS, 2.6 * rows)
    figure, axes = plt.subplots(
        rows, COLUMNS, figsize=size, sharey=True, squeeze=False, layout="constrained"
    )
    panels = list(axes.flat)
    for panel, name in zip(panels, names, strict=False):
        column = report.model.card.names.index(name)
        _draw(panel, steps[:, column].numpy(), reward)
        panel.set_xlabel(f"{name} (slope {report.slopes[name]:+.2f})")
    for panel in panels[len(names) :]:
        panel.remove()
    for row in axes[:, 0]:
        row.set_ylabel("learned reward")
    save(figure, panels[: len(names)], path)


def _draw(panel: Axes, values: np.ndarray, reward: np.ndarray) -> None:
    middle, groups = _groups(values)
    quartiles = np.array([np.quantile(reward[g], (0.25, 0.5, 0.75)) for g in groups])
    panel.fill_between(
        middle, quartiles[:, 0], quartiles[:, 2], alpha=0.3, label="half of the steps"
    )
    panel.plot(middle, quartiles[:, 1], marker=".", label="median")


def _groups(values: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Medians of groups of values, ascending, and the rows of each; one group for all
    that have the same median.
    """
    parts = np.array_split(np.argsort(values, kind="stable"), BINS)
    parts = [part for part in parts if len(part)]
    medians = np.array([np.median(values[part]) for part in parts])
    middle = np.unique(medians)
    chosen = [np.flatnonzero(medians == value) for value in middle]
    return middle, [np.concatenate([parts[i] for i in rows]) for rows in chosen]
