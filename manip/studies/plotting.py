"""Parts that all figures of the studies share."""

from collections.abc import Sequence
from math import ceil, floor, log10
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, MaxNLocator, NullLocator

from manip.io.atomic_files import replace_file

MOST_TICKS = 6
"""Labels of a logarithmic axis; more would overlap."""

STEPS = ((1, 2, 5), (1, 3), (1,))
"""Ticks within a decade, from the finest choice to the coarsest."""


def log_ticks(low: float, high: float) -> list[float]:
    """Choose 2 to `MOST_TICKS` round numbers in [low, high], for a logarithmic axis."""
    decades = range(floor(log10(low)), ceil(log10(high)) + 1)
    for steps in STEPS:
        ticks = [step * 10.0**decade for decade in decades for step in steps]
        inside = [tick for tick in ticks if low <= tick <= high]
        if len(inside) < 3:  # less than a decade: evenly spaced numbers
            return _linear_ticks(low, high)
        if len(inside) <= MOST_TICKS:
            return inside
    return inside[:: ceil(len(inside) / MOST_TICKS)]


def _linear_ticks(low: float, high: float) -> list[float]:
    ticks = MaxNLocator(MOST_TICKS - 2).tick_values(low, high)
    return [float(tick) for tick in ticks if low <= tick <= high]


def label_log_axis(axis: Axis) -> None:
    """Put a few plain numbers on a logarithmic axis, once all data is drawn."""
    axis.set_major_locator(FixedLocator(log_ticks(*axis.get_view_interval())))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


def save(figure: Figure, panels: Sequence[Axes], path: Path) -> None:
    """Add grids and the first panel's legend, and write the figure."""
    for axes in panels:
        axes.grid(alpha=0.3)
        _label_log_axes(axes)
    panels[0].legend(fontsize="small")
    replace_file(path, lambda part: figure.savefig(part, dpi=120))
    plt.close(figure)


def _label_log_axes(axes: Axes) -> None:
    """Label logarithmic axes; matplotlib refuses to draw one without any data."""
    for name, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
        if not isinstance(axis.get_major_locator(), LogLocator):
            continue
        if min(axis.get_view_interval()) > 0:
            label_log_axis(axis)
        else:
            axes.set(**{f"{name}scale": "linear"})
