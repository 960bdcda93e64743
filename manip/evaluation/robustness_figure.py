"""Draw success against the strength of each perturbation."""

from math import ceil
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from manip.evaluation.robustness import PerturbedResult, Robustness
from manip.io.atomic_files import replace_file

COLUMNS = 4


def draw_robustness(result: Robustness, path: Path) -> None:
    """Draw success_held and its 95 % interval, a panel for each perturbation (.png)."""
    rows = max(1, ceil(len(result.perturbed) / COLUMNS))
    figure = Figure(figsize=(3 * COLUMNS, 0.6 + 2.3 * rows), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, sharey=True, squeeze=False).flat
    for axes, perturbed in zip(panels, result.perturbed, strict=False):
        _draw_panel(axes, result, perturbed)
    for axes in list(panels)[len(result.perturbed) :]:
        axes.set_axis_off()
    figure.suptitle(
        f"{result.task}, {result.algo}: success held [%] under perturbations "
        f"({result.env}, {result.fidelity}, {result.episodes} episodes each)"
    )
    replace_file(path, lambda partial: figure.savefig(partial, dpi=100))


def _draw_panel(axes: Axes, result: Robustness, perturbed: PerturbedResult) -> None:
    levels = [result.nominal, *perturbed.levels]
    rates = [level.success["success_held"] for level in levels]
    heights = [100 * rate.rate for rate in rates]
    errors = [
        [100 * (rate.rate - rate.low) for rate in rates],
        [100 * (rate.high - rate.rate) for rate in rates],
    ]
    places = range(len(levels))
    axes.axhline(heights[0], color="grey", linestyle=":")
    axes.errorbar(places, heights, errors, marker="o", capsize=3)
    words = ["nominal", *(f"{level.value:g}" for level in perturbed.levels)]
    axes.set_xticks(list(places), words)
    axes.set(title=perturbed.name, xlabel=perturbed.unit, ylim=(-4, 104))
    axes.grid(alpha=0.3)
