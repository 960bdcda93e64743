"""Pictures of the studies: a line is the mean over seeds, a band their range."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from manip.io.atomic_files import replace_file
from manip.studies.gradients import BASELINE, NS, Found
from manip.studies.learning import Evaluated

ESTIMATES = {
    "R": "REINFORCE",
    BASELINE: "REINFORCE with a baseline",
    "n = 4": "actor-critic, n = 4",
}
"""Weight of log pi -> who uses it."""

N_OF = {f"n = {n}": n for n in NS}


def draw_variance(found: Sequence[Found], path: Path) -> None:
    """Noise of the gradient: REINFORCE, with a baseline, and actor-critic."""
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for weight, label in ESTIMATES.items():
        rows = [row for row in found if row.weight == weight]
        _line(axes, rows, _thousands, lambda row: row.noise, label)
    axes.set(
        title=f"Noise of one gradient estimate, {found[0].task}",
        xlabel="control steps of training [thousand]",
        ylabel="trace of covariance / |mean|²",
        yscale="log",
    )
    _save(figure, [axes], path)


def draw_bias(found: Sequence[Found], path: Path) -> None:
    """Noise and bias of the gradient against n, at each stage of training."""
    figure, sides = plt.subplots(1, 2, figsize=(10, 4.5), layout="constrained")
    for steps in sorted({row.env_steps for row in found}):
        rows = [r for r in found if r.env_steps == steps and r.weight in N_OF]
        label = f"after {steps / 1000:,.0f} thousand steps"
        _line(sides[0], rows, _n, lambda row: row.noise, label)
        _line(sides[1], rows, _n, lambda row: row.bias, label)
    for axes, title in zip(sides, ("noise", "squared bias"), strict=True):
        axes.set_xscale("log", base=2)
        axes.set_xticks(NS, [str(n) for n in NS])
        axes.set(title=title, xlabel="n", ylabel="relative to |mean gradient|²")
    sides[0].set_yscale("log")
    sides[1].set_yscale("symlog", linthresh=0.1)
    sides[1].set_ylim(bottom=0)
    figure.suptitle(f"Estimates from n rewards and the critic, {found[0].task}")
    _save(figure, list(sides), path)


def draw_clipping(found: Sequence[Evaluated], path: Path) -> None:
    """Success, and how far updates go, against control steps; epochs by colour."""
    figure, sides = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
    for axes in sides:
        axes.set_prop_cycle(color=["tab:blue", "tab:orange", "tab:green"])
    for variant in dict.fromkeys(row.variant for row in found):
        rows = [row for row in found if row.variant == variant]
        style = "--" if "no clip" in variant else "-"
        _line(sides[0], rows, _thousands, _percent, variant, style)
        _line(sides[1], rows, _thousands, lambda row: row.kl, variant, style)
    sides[0].set(ylabel="success held [%]", ylim=(-3, 103))
    sides[1].set(ylabel="KL divergence of an update", yscale="log")
    for axes in sides:
        axes.set(xlabel="control steps [thousand]")
    figure.suptitle(f"PPO's epochs with and without clipping, {found[0].task}")
    _save(figure, list(sides), path)


def draw_algorithms(found: Sequence[Evaluated], path: Path) -> None:
    """Success against control steps and against computing time, a row a task."""
    tasks = list(dict.fromkeys(row.task for row in found))
    size = (11, 4.5 * len(tasks))
    figure, grid = plt.subplots(
        len(tasks), 2, figsize=size, layout="constrained", squeeze=False
    )
    for pair, task in zip(grid, tasks, strict=True):
        of_task = [row for row in found if row.task == task]
        for algo in dict.fromkeys(row.variant for row in of_task):
            rows = [row for row in of_task if row.variant == algo]
            _line(pair[0], rows, _thousands, _percent, algo)
            _line(pair[1], rows, lambda row: row.cpu_seconds, _percent, algo)
        pair[0].set(xlabel="control steps [thousand]")
        pair[1].set(xlabel="computing time [CPU s]")
        for axes in pair:
            axes.set(title=task, ylabel="success held [%]", ylim=(-3, 103))
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.xaxis.set_major_formatter("{x:g}")
    _save(figure, [axes for pair in grid for axes in pair], path)


def _thousands(row: Found | Evaluated) -> float:
    return row.env_steps / 1000


def _percent(row: Evaluated) -> float:
    return 100 * row.success_held


def _n(row: Found) -> float:
    return N_OF[row.weight]


def _line(
    axes: Axes,
    rows: Sequence[Any],
    x: Callable[[Any], float],
    y: Callable[[Any], float],
    label: str,
    style: str = "-",
) -> None:
    """The mean over seeds of their first, second, ... rows, and the range of y."""
    seeds = [[r for r in rows if r.seed == s] for s in sorted({r.seed for r in rows})]
    together = list(zip(*seeds, strict=False))
    across = np.array([np.mean([x(row) for row in rank]) for rank in together])
    up = np.array([[y(row) for row in rank] for rank in together])
    (line,) = axes.plot(across, up.mean(1), style, marker="o", ms=3, label=label)
    color = line.get_color()
    axes.fill_between(across, up.min(1), up.max(1), color=color, alpha=0.15, lw=0)


def _save(figure: Figure, panels: Sequence[Axes], path: Path) -> None:
    for axes in panels:
        axes.grid(alpha=0.3)
    panels[0].legend(fontsize="small")
    replace_file(path, lambda temporary: figure.savefig(temporary, dpi=120))
    plt.close(figure)
