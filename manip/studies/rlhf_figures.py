"""Figures of the study of preferences: means over seeds, with Student's intervals."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import nan, sqrt
from pathlib import Path
from statistics import fmean

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from manip.io.atomic_files import replace_file
from manip.studies.bootstrap import Interval
from manip.studies.plotting import save
from manip.studies.rlhf import PreferenceRow
from manip.studies.rlhf_variants import (
    BETAS,
    COUNTS,
    FEW,
    FLAWED,
    FULL,
    LABELS,
    OUTSIDE,
    REFERENCE,
    TRUE,
    Part,
    few_name,
    labels_name,
    raw_name,
)
from manip.studies.seed_interval import seed_interval

Rows = Sequence[PreferenceRow]
Value = Callable[[PreferenceRow], float]
Draw = Callable[[Rows, Path], None]


@dataclass(frozen=True)
class Panel:
    """A quantity that is shown for each variant.

    Attributes:
        title: of the panel, with the unit.
        value: of a row.
    """

    title: str
    value: Value


PANELS = (
    Panel("success held [%]", lambda row: 100 * row.success_held),
    Panel("penalty of the taste per step", lambda row: row.penalty),
    Panel("utility per step", lambda row: row.utility),
)
"""What the figures of bars show: utility is task reward minus weighted penalty."""

MOST_PERCENT = 102.0
"""End of the axis of success; intervals may reach beyond 100 %."""

METHODS = {
    REFERENCE: "reference (no labels)",
    "clone winners, first": "clone winners",
    "clone winners": "clone winners, in rounds",
    "dpo, first": "DPO",
    "dpo": "DPO, in rounds",
    "clone episodes": "clone best fresh episodes, in rounds",
    f"{FULL}, first": "PPO + KL",
    FULL: "PPO + KL, in rounds",
    TRUE: "PPO, taste known as a formula",
}
"""Variant -> its label in the figure of methods, from top to bottom."""

INPUTS = {
    REFERENCE: "reference (no labels)",
    raw_name(): "model sees observation, action",
    labels_name(OUTSIDE, True): "model sees named measures",
    TRUE: "taste known as a formula",
}

LABELLERS = {
    REFERENCE: "reference (no labels)",
    FULL: "oracle",
    **{f"{FULL}, {name}": name for name in FLAWED},
    TRUE: "taste known as a formula",
}


def draw_methods(rows: Rows, path: Path) -> None:
    """Draw each method at equal labels."""
    _bars(rows, METHODS, f"{LABELS} labels", path)


def draw_inputs(rows: Rows, path: Path) -> None:
    """Draw what a reward model gains that has no named measures."""
    _bars(rows, INPUTS, f"PPO + KL, {OUTSIDE} labels in rounds", path)


def draw_labellers(rows: Rows, path: Path) -> None:
    """Draw each simulated labeller."""
    _bars(rows, LABELLERS, f"PPO + KL, {LABELS} labels in rounds", path)


def _bars(rows: Rows, labels: Mapping[str, str], title: str, path: Path) -> None:
    """Draw a line for each variant: its mean, interval and seeds, in four panels."""
    shown = {name: label for name, label in labels.items() if last(rows, name)}
    quantities = [*PANELS, Panel("share of the known taste's gain [%]", gain(rows))]
    figure, panels = plt.subplots(
        1,
        len(quantities),
        figsize=(13, 1.3 + 0.36 * len(shown)),
        layout="constrained",
        sharey=True,
    )
    for axes, panel in zip(panels, quantities, strict=True):
        for place, name in enumerate(shown):
            _bar(axes, place, [panel.value(row) for row in last(rows, name)])
        axes.set_title(panel.title, fontsize="medium")
        axes.grid(axis="x", alpha=0.3)
    panels[0].set_xlim(right=min(panels[0].get_xlim()[1], MOST_PERCENT))
    panels[0].set_yticks(range(len(shown)), list(shown.values()), fontsize="small")
    panels[0].set_ylim(len(shown) - 0.5, -0.5)
    figure.suptitle(_title(rows, title))
    _write(figure, path)


def _title(rows: Rows, what: str) -> str:
    first, seeds = rows[0], len({row.seed for row in rows})
    return f"{first.task}, {first.taste} taste: {what}; {seeds} seeds, 95 % intervals"


def _write(figure: Figure, path: Path) -> None:
    replace_file(path, lambda part: figure.savefig(part, dpi=120))
    plt.close(figure)


def gain(rows: Rows) -> Value:
    """What a run gains in utility over its reference, in percent of what the run with
    the known taste gains over the same reference.
    """
    reference = {row.seed: row.utility for row in last(rows, REFERENCE)}
    true = {row.seed: row.utility for row in last(rows, TRUE)}

    def share(row: PreferenceRow) -> float:
        start, end = reference[row.seed], true[row.seed]
        return 100 * (row.utility - start) / (end - start)

    return share


def _bar(axes: Axes, place: int, values: Sequence[float]) -> None:
    interval, color = seed_interval(values), f"C{place % 10}"
    ends = [interval.low, interval.high]
    axes.plot(ends, [place] * 2, lw=7, alpha=0.3, color=color, solid_capstyle="butt")
    axes.plot(interval.value, place, "|", ms=14, mew=2, color=color)
    axes.plot(values, [place] * len(values), "o", ms=3, color=color)
    large = max(map(abs, values)) > 2
    text = f"{interval.value:.0f}" if large else f"{interval.value:.2f}"
    place_of_text = (interval.value, place - 0.22)
    axes.annotate(text, place_of_text, fontsize="x-small", ha="center", va="bottom")


def draw_overoptimisation(rows: Rows, path: Path) -> None:
    """Draw learned reward and utility against the distance from the reference."""
    figure, panels = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
    start = [row for row in rows if row.variant == REFERENCE]
    curves = {few_name(beta): f"{FEW} labels, raw, beta {beta:g}" for beta in BETAS}
    curves[f"{FULL}, beta 0"] = f"{LABELS} labels in rounds, named, beta 0"
    for index, (name, label) in enumerate(curves.items()):
        curve = [row for row in rows if row.variant == name]
        style = "o-" if index < len(BETAS) else "s--"
        if curve:
            color = f"C{index}"
            _curve(panels[0], curve, _learned, style, color, label)
            _curve(panels[1], start + curve, _utility, style, color, label)
    panels[0].set_title("what the model says: learned reward per step")
    panels[1].set_title("what the labeller wants: utility per step")
    for axes in panels:
        axes.set_xlabel("sqrt(KL from the reference) [nat$^{1/2}$ per step]")
        axes.set_xlim(left=0.0)
    figure.suptitle(_title(rows, "PPO + KL after each third of a run"))
    save(figure, list(panels), path)


def _learned(row: PreferenceRow) -> float:
    return nan if row.learned is None else row.learned


def _utility(row: PreferenceRow) -> float:
    return row.utility


def _curve(
    axes: Axes, rows: Rows, value: Value, style: str, color: str, label: str
) -> None:
    """Draw means over seeds with their intervals, a point for each stage."""
    stages = sorted({(row.variant != REFERENCE, row.env_steps) for row in rows})
    points = [
        [row for row in rows if (row.variant != REFERENCE, row.env_steps) == stage]
        for stage in stages
    ]
    across = [fmean(sqrt(row.divergence) for row in point) for point in points]
    values = [seed_interval([value(row) for row in point]) for point in points]
    _with_errors(axes, across, values, style, color, label)


def _with_errors(
    axes: Axes,
    across: Sequence[float],
    values: Sequence[Interval],
    style: str,
    color: str,
    label: str,
) -> None:
    middle = [v.value for v in values]
    half = np.nan_to_num([v.high - v.value for v in values])
    axes.errorbar(
        across, middle, half, fmt=style, ms=4, capsize=2, color=color, label=label
    )


def draw_labels(rows: Rows, path: Path) -> None:
    """Draw success and utility against the number of comparisons."""
    figure, panels = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    for axes, panel in zip(panels, (PANELS[2], PANELS[0]), strict=True):
        for index, in_rounds in enumerate((True, False)):
            rows_of = {n: last(rows, labels_name(n, in_rounds)) for n in COUNTS}
            counts = [count for count in COUNTS if rows_of[count]]
            values = [seed_interval([*map(panel.value, rows_of[n])]) for n in counts]
            # The two lines would hide each other's intervals.
            across = [count * (1 + 0.06 * index) for count in counts]
            label = "labels in rounds" if in_rounds else "all labels first"
            _with_errors(axes, across, values, "o-", f"C{index}", label)
        for name, style in ((REFERENCE, ":"), (TRUE, "--")):
            if known := last(rows, name):
                level = seed_interval([*map(panel.value, known)]).value
                axes.axhline(level, ls=style, color="gray", label=METHODS[name])
        axes.set(title=panel.title, xlabel="labels", xscale="log")
        axes.set_xticks(COUNTS, [str(count) for count in COUNTS], minor=False)
        axes.minorticks_off()
    panels[1].set_ylim(top=min(panels[1].get_ylim()[1], MOST_PERCENT))
    figure.suptitle(_title(rows, "PPO + KL"))
    for axes in panels:
        axes.grid(alpha=0.3)
    panels[0].legend(fontsize="small")
    _write(figure, path)


def last(rows: Rows, name: str) -> list[PreferenceRow]:
    """The rows of a variant after its last stage, a row for each seed."""
    own = [row for row in rows if row.variant == name]
    steps = max((row.env_steps for row in own), default=0)
    return [row for row in own if row.env_steps == steps]


FIGURES: dict[Part, Draw] = {
    "methods": draw_methods,
    "overoptimisation": draw_overoptimisation,
    "labels": draw_labels,
    "inputs": draw_inputs,
    "labellers": draw_labellers,
}
"""Part of the study -> its figure."""
