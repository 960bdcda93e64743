"""Figures of the study of preferences: means over seeds, with Student's intervals."""

from collections.abc import Callable, Mapping, Sequence
from math import isnan, nan, sqrt
from pathlib import Path
from statistics import fmean

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from manip.io.atomic_files import replace_file
from manip.studies.bootstrap import Interval
from manip.studies.plotting import save
from manip.studies.rlhf import PreferenceRow
from manip.studies.rlhf_variants import (
    BETA,
    BETAS,
    CLOSER,
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
Values = Callable[[Rows, str], list[float]]
Draw = Callable[[Rows, Path], None]


MOST_PERCENT = 102.0
"""End of the axis of success; intervals may reach beyond 100 %."""

METHODS = {
    REFERENCE: "reference (no labels)",
    "clone winners, first": "clone winners",
    "dpo, first": "DPO",
    "clone episodes": "clone best fresh episodes, in rounds",
    f"{FULL}, first": "PPO + KL",
    FULL: "PPO + KL, in rounds",
    TRUE: "PPO, taste known as a formula",
}
"""Variant -> its label in the figure of methods, from top to bottom."""

INPUTS = {
    REFERENCE: "reference (no labels)",
    **{
        raw_name(beta): f"{OUTSIDE} labels; observation, action; beta {beta:g}"
        for beta in (BETA, CLOSER)
    },
    FULL: f"{LABELS} labels; named measures; beta {BETA:g}",
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
    _bars(rows, INPUTS, "PPO + KL, labels in rounds, by inputs of the model", path)


def draw_labellers(rows: Rows, path: Path) -> None:
    """Draw each simulated labeller."""
    _bars(rows, LABELLERS, f"PPO + KL, {LABELS} labels in rounds", path)


def _bars(rows: Rows, labels: Mapping[str, str], title: str, path: Path) -> None:
    """Draw a line for each variant: its mean, interval and seeds, in three panels."""
    shown = {name: label for name, label in labels.items() if last(rows, name)}
    figure, panels = plt.subplots(
        1,
        len(PANELS),
        figsize=(11.5, 1.3 + 0.36 * len(shown)),
        layout="constrained",
        sharey=True,
    )
    for axes, (panel, values) in zip(panels, PANELS.items(), strict=True):
        axes.set_xlim(_limits([v for name in shown for v in values(rows, name)]))
        for place, name in enumerate(shown):
            _bar(axes, place, values(rows, name), _text(rows, name, values))
        axes.set_title(panel, fontsize="medium")
        axes.grid(axis="x", alpha=0.3)
        axes.xaxis.set_major_locator(MaxNLocator(5))
    panels[0].set_xlim(right=MOST_PERCENT)
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


def gains(rows: Rows, name: str) -> list[float]:
    """Utility of a variant minus that of the reference of the same seed, by seed."""
    start = {row.seed: row.utility for row in last(rows, REFERENCE)}
    return [row.utility - start[row.seed] for row in last(rows, name)]


def share_of_gain(rows: Rows, name: str) -> float:
    """Mean gain in percent of that with the taste as the reward; nan without these."""
    known = gains(rows, TRUE)
    return 100 * fmean(gains(rows, name)) / fmean(known) if known else nan


def _success(rows: Rows, name: str) -> list[float]:
    return [100 * row.success_held for row in last(rows, name)]


def _penalties(rows: Rows, name: str) -> list[float]:
    return [row.penalty for row in last(rows, name)]


def _utilities(rows: Rows, name: str) -> list[float]:
    return [row.utility for row in last(rows, name)]


PANELS = {
    "success held [%]": _success,
    "penalty of the taste per step": _penalties,
    "gain in utility per step": gains,
}
"""Title -> values of a variant, one for each seed; utility is the task's reward minus
the weighted penalty, and gains are relative to the reference of the same seed."""


def _text(rows: Rows, name: str, values: Values) -> str:
    """The mean; for gains also in percent of what the known taste gains."""
    mean = fmean(values(rows, name))
    if values is _success:
        return f"{mean:.0f}"
    share = share_of_gain(rows, name)
    if values is not gains or isnan(share):
        return f"{mean:.2f}"
    return f"{mean:+.2f} ({share:.0f} %)"


def _limits(values: Sequence[float]) -> tuple[float, float]:
    """Ends of an axis: all values but those far from the quartiles (Tukey's rule)."""
    low, high = np.quantile(values, (0.25, 0.75))
    span = max(values) - min(values) or 0.1
    reach = 3 * max(high - low, span / 10)
    margin = span / 20
    ends = max(min(values), low - reach), min(max(values), high + reach)
    return float(ends[0] - margin), float(ends[1] + margin)


def _bar(axes: Axes, place: int, values: Sequence[float], text: str) -> None:
    """Draw mean, interval and seeds; arrows stand for seeds beyond the axis."""
    interval, color = seed_interval(values), f"C{place % 10}"
    ends = [interval.low, interval.high]
    axes.plot(ends, [place] * 2, lw=7, alpha=0.3, color=color, solid_capstyle="butt")
    axes.plot(interval.value, place, "|", ms=14, mew=2, color=color)
    low, high = axes.get_xlim()
    for value in values:
        marker = "<" if value < low else ">" if value > high else "o"
        size = 3 if marker == "o" else 7
        inside = min(max(value, low), high)
        axes.plot(inside, place, marker, ms=size, color=color, clip_on=False)
    above = (min(max(interval.value, low + 0.15 * (high - low)), high), place - 0.22)
    axes.annotate(text, above, fontsize="x-small", ha="center", va="bottom")


def draw_overoptimisation(rows: Rows, path: Path) -> None:
    """Draw learned reward and utility against the distance from the reference."""
    figure, panels = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
    start = last(rows, REFERENCE)
    utility = {row.seed: row.utility for row in start}

    def gain(row: PreferenceRow) -> float:
        return row.utility - utility[row.seed]

    inputs = "observation + action"
    curves = {
        few_name(beta): f"{FEW} labels, {inputs}, beta {beta:g}" for beta in BETAS
    }
    curves[FULL] = f"{LABELS} labels in rounds, named measures, beta {BETA:g}"
    for index, (name, label) in enumerate(curves.items()):
        curve = [row for row in rows if row.variant == name]
        style = "o-" if index < len(BETAS) else "s--"
        if curve:
            color = f"C{index}"
            _curve(panels[0], curve, _learned, style, color, label)
            _curve(panels[1], start + curve, gain, style, color, label)
    panels[0].set_title("what the model says: learned reward per step")
    panels[1].set_title("what the labeller wants: gain in utility per step")
    for axes in panels:
        axes.set_xlabel("sqrt(KL from the reference) [nat$^{1/2}$ per step]")
        axes.set_xlim(left=0.0)
    figure.suptitle(_title(rows, "PPO + KL after each third of a run"))
    save(figure, list(panels), path)


def _learned(row: PreferenceRow) -> float:
    return nan if row.learned is None else row.learned


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
    shown = {"utility per step": _utilities, "success held [%]": _success}
    for axes, (panel, of) in zip(panels, shown.items(), strict=True):
        for index, in_rounds in enumerate((True, False)):
            counts = [n for n in COUNTS if last(rows, labels_name(n, in_rounds))]
            names = [labels_name(count, in_rounds) for count in counts]
            values = [seed_interval(of(rows, name)) for name in names]
            # The two lines would hide each other's intervals.
            across = [count * (1 + 0.06 * index) for count in counts]
            label = "labels in rounds" if in_rounds else "all labels first"
            _with_errors(axes, across, values, "o-", f"C{index}", label)
        for name, style in ((REFERENCE, ":"), (TRUE, "--")):
            if known := of(rows, name):
                level = fmean(known)
                axes.axhline(level, ls=style, color="gray", label=METHODS[name])
        axes.set(title=panel, xlabel="labels", xscale="log")
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
