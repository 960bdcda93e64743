"""Figures of the gradient study: a line per seed, with 95 % bootstrap intervals."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from manip.studies.gradients import BASELINE, NS, RETURN, GradientRow
from manip.studies.plotting import save

Array = np.ndarray

ESTIMATES = {
    RETURN: "REINFORCE",
    BASELINE: "REINFORCE with a baseline",
    "n = 4": "actor-critic, n = 4",
}
"""Weight of log pi -> the algorithm that uses it."""

POSITIONS = {f"n = {n}": n for n in NS} | {RETURN: 2 * max(NS)}
"""Weight -> its place on the logarithmic axis of n; R, the control, is the last."""

DODGE = 0.03
"""Distance between points of one stage, which would hide each other."""

UNBOUNDED = 1e30
"""The upper end of a band without an upper bound: beyond the axis."""

LINEAR_BELOW = 0.1
"""The axis of squared bias is linear from zero to this value, then logarithmic."""


def draw_variance(rows: Sequence[GradientRow], path: Path) -> None:
    """Draw the noise of REINFORCE, with a baseline, and actor-critic."""
    figure, axes = plt.subplots(figsize=(7.5, 4.5), layout="constrained")
    stages, seeds = sorted({row.env_steps for row in rows}), _seeds(rows)
    for k, (weight, label) in enumerate(ESTIMATES.items()):
        for i, seed in enumerate(seeds):
            curve = [row for row in rows if (row.weight, row.seed) == (weight, seed)]
            shift = k * len(seeds) + i - (len(ESTIMATES) * len(seeds) - 1) / 2
            places = np.arange(len(stages)) + DODGE * shift
            _noise_bars(axes, places, curve, f"C{k}", "" if i else label)
    axes.set_xticks(range(len(stages)), [f"{steps / 1000:,.0f}" for steps in stages])
    axes.set_title(
        f"Noise of a gradient estimate, {rows[0].task}: a line per seed, "
        "95 % bootstrap intervals",
        fontsize="medium",
    )
    axes.set(
        xlabel="control steps of training [thousand]",
        ylabel="noise / |mean gradient|²",
        yscale="log",
    )
    save(figure, [axes], path)


def _noise_bars(
    axes: Axes, places: Array, curve: Sequence[GradientRow], color: str, label: str
) -> None:
    noise = np.array([row.noise for row in curve])
    below = noise - [row.noise_low for row in curve]
    above = np.array([row.noise_high for row in curve]) - noise
    # A missing bound is drawn without a bar.
    lengths = np.nan_to_num(np.maximum([below, above], 0))
    axes.errorbar(
        places[: len(curve)],
        noise,
        lengths,
        fmt="o-",
        markersize=3,
        linewidth=1,
        capsize=2,
        alpha=0.8,
        color=color,
        label=label,
    )


def draw_bias(rows: Sequence[GradientRow], path: Path) -> None:
    """Draw noise and squared bias against n, one column per stage of training.

    The last place of the axis is the control: REINFORCE, whose bias is zero. Dotted
    lines are the noise floor: the value that chance exceeds in 5 % of the cases.
    """
    stages = _stages(rows)
    size = (1 + 4 * len(stages), 7)
    figure, grid = plt.subplots(
        2, len(stages), figsize=size, layout="constrained", squeeze=False, sharey="row"
    )
    for column, (title, stage) in zip(grid.T, stages.items(), strict=True):
        _draw_stage(column[0], column[1], stage)
        column[0].set_title(title)
    _limit(grid[0, 0], rows, "noise")
    _limit(grid[1, 0], rows, "bias")
    grid[0, 0].set(ylabel="noise / |mean gradient|²")
    grid[1, 0].set(ylabel="squared bias / |mean gradient|²")
    grid[1, 0].plot([], [], ":", color="gray", label="noise floor (95 %)")
    grid[1, 0].legend(fontsize="small")
    figure.suptitle(f"Estimates from n rewards and the critic, {rows[0].task}")
    save(figure, list(grid.flat), path)


def _draw_stage(above: Axes, below: Axes, rows: Sequence[GradientRow]) -> None:
    for k, seed in enumerate(_seeds(rows)):
        curve = [row for row in rows if row.seed == seed and row.weight in POSITIONS]
        curve.sort(key=lambda row: POSITIONS[row.weight])
        _curve(above, curve, "noise", f"C{k}", f"seed {seed}")
        _curve(below, curve, "bias", f"C{k}", None)
        places = [POSITIONS[row.weight] for row in curve]
        below.plot(places, [row.bias_floor for row in curve], ":", color=f"C{k}")
    above.set_yscale("log")
    below.set_yscale("symlog", linthresh=LINEAR_BELOW)
    below.yaxis.set_major_formatter("{x:g}")
    for axes in (above, below):
        axes.set_xscale("log", base=2)
        axes.set_xticks([*POSITIONS.values()], [*map(str, NS), "R"])
        axes.minorticks_off()
        axes.set_xlabel("n (R: REINFORCE, the control)")


def _curve(
    axes: Axes, curve: Sequence[GradientRow], name: str, color: str, label: str | None
) -> None:
    places = [POSITIONS[row.weight] for row in curve]
    values, low, high = (
        np.array([getattr(row, name + end) for row in curve])
        for end in ("", "_low", "_high")
    )
    axes.plot(places, values, "o-", ms=3, color=color, label=label)
    top = np.where(np.isnan(high) & ~np.isnan(values), UNBOUNDED, high)
    axes.fill_between(places, low, top, color=color, alpha=0.15, lw=0)


def _limit(axes: Axes, rows: Sequence[GradientRow], name: str) -> None:
    """Limit the vertical axis to the finite values and bounds."""
    ends = [getattr(row, name + end) for row in rows for end in ("", "_low", "_high")]
    finite = [end for end in ends if end > 0]
    if finite:
        bottom = 0 if name == "bias" else 0.7 * min(finite)
        axes.set_ylim(bottom, 1.5 * max(finite))


def _seeds(rows: Sequence[GradientRow]) -> list[int]:
    return sorted({row.seed for row in rows})


def _stages(rows: Sequence[GradientRow]) -> dict[str, list[GradientRow]]:
    """Title -> the rows of a stage of training."""
    steps = sorted({row.env_steps for row in rows})
    return {
        f"after {count / 1000:,.0f} thousand steps": [
            row for row in rows if row.env_steps == count
        ]
        for count in steps
    }
