"""`manip reward`: learn a reward from comparisons, and show what it pays for."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro
from rich.console import Console
from rich.table import Table

from manip.errors import UserError, at_least
from manip.evaluation.statistics import Rate
from manip.io.output_paths import PLOT_FORMATS, check_output
from manip.preferences.agreement import Repeats
from manip.preferences.label_options import Inputs
from manip.preferences.reward_model import FILE
from manip.preferences.reward_report import RewardReport, report
from manip.programs import cli
from manip.programs.output import console


@dataclass(frozen=True)
class Reward:
    """Learn a reward from the comparisons in a folder, and show what it pays for.

    The reward is written to the folder, as reward_model.safetensors. The accuracy is
    that of predictions for pairs that were not learned from (cross-validation).
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Folder of preferences, which `manip train --preferences` fills."""
    inputs: Inputs = "measures"
    """What the reward model sees of a step: the task's visible measures, or observation
    and action."""
    members: int = 3
    """Networks in the ensemble."""
    folds: int = 5
    """Parts into which the comparisons are divided for cross-validation: more take
    longer, and judge models that have learned from more."""
    seed: int = 0
    """Seed of the fits."""
    plot: Path | None = None
    """File for a figure of the reward against each measure, .png, .pdf or .svg;
    DIR/reward.png unless given."""


def main(arguments: Sequence[str]) -> int:
    """Fit, write model and figure, print the tables."""
    options = cli.parse(Reward, arguments, "manip reward")
    cli.check_range("--members", options.members, 1, 100)
    cli.check_range("--folds", options.folds, 2, 100)
    at_least(0, "--seed", options.seed)
    if not options.folder.is_dir():
        raise UserError(f"there is no folder {options.folder}")
    figure = options.plot or options.folder / "reward.png"
    check_output(figure, "--plot", PLOT_FORMATS)
    torch.set_num_threads(1)  # the sums of several threads would differ
    result = report(
        options.folder, options.inputs, options.members, options.folds, options.seed
    )
    result.model.save(options.folder / FILE)
    _print(result, console())
    from manip.studies.reward_figure import draw_reward  # matplotlib is slow to load

    draw_reward(result, figure)
    print(f"reward: {options.folder / FILE}\nfigure: {figure}")
    return 0


def _print(result: RewardReport, out: Console) -> None:
    card = result.model.card
    counts = ", ".join(f"{n} {name}" for name, n in sorted(result.answers.items()))
    out.print(f"{card.task}, clips of {card.clip_steps} steps: {counts}")
    out.print(f"accuracy on pairs not learned from: {_share(result.accuracy)}")
    for what, repeats in (
        ("agreement with own earlier answers", result.agreement.within),
        ("agreement between labellers", result.agreement.between),
    ):
        out.print(f"{what}: {_repeats(repeats)}")
    out.print(_calibration(result))
    out.print(_slopes(result))


def _calibration(result: RewardReport) -> Table:
    table = Table("chance given to the choice", "mean", "right", title="calibration")
    for row in result.calibration:
        mean = "" if row.predicted is None else f"{row.predicted:.0%}"
        table.add_row(f"{row.low:.0%} to {row.high:.0%}", mean, _share(row.correct))
    return table


def _slopes(result: RewardReport) -> Table:
    table = Table("input", "slope", title="reward for one standard deviation more")
    for name, slope in sorted(result.slopes.items(), key=lambda item: -abs(item[1])):
        table.add_row(name, f"{slope:+.2f}")
    return table


def _share(rate: Rate | None) -> str:
    if rate is None:
        return "no pairs"
    return f"{rate.rate:.0%} (95 % interval {rate.low:.0%} to {rate.high:.0%})"


def _repeats(repeats: Repeats) -> str:
    return _share(repeats.rate) if repeats.total else "no repeated pairs"
