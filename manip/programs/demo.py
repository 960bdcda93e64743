"""`make demo`: train, evaluate in stock robosuite, render, plot."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from rich.table import Table
from rich.text import Text

from manip.errors import at_least
from manip.evaluation.report import Evaluation, table
from manip.io.atomic_files import write_text
from manip.io.output_paths import check_output_folder
from manip.io.printable import printable
from manip.programs import cli
from manip.programs.demo_folder import FILES, is_unfinished, remove_finished
from manip.programs.evaluate import Evaluate, evaluate
from manip.programs.output import console
from manip.programs.render import Render, render_video
from manip.training.config import TrainConfig
from manip.training.final_evaluation import check_episodes
from manip.training.recipes import recipe
from manip.training.run import RunResult, train
from manip.training.terminal import TerminalProgress

STOPPED = 3
"""Exit code: interrupted and saved."""


@dataclass(frozen=True)
class Demo:
    """Train a Panda to lift a cube with SAC, evaluate it in stock robosuite, render it.

    An interrupted demo continues with the same command; a finished one starts anew.
    """

    out: Path = Path("runs/demo")
    """Folder for everything that the demo makes."""
    seed: int = 0
    """Seed of the training run."""
    episodes: int = 100
    """Number of evaluation episodes. More episodes narrow the intervals."""


def main(arguments: Sequence[str]) -> int:
    """Run the demo; exit code 0 at its end, 3 if training was stopped and saved."""
    options = cli.parse(Demo, arguments, "demo")
    _check(options)
    torch.set_num_threads(1)
    _print_step("1/3  train: Lift, Panda, SAC")
    with TerminalProgress() as progress:
        run = train(_config(options), callback=progress)
    if not run.finished:
        return STOPPED
    _print_step(f"2/3  evaluate: {options.episodes} episodes in stock robosuite")
    result = evaluate(Evaluate(options.out, episodes=options.episodes))
    write_text(options.out / "eval.json", result.to_json())
    _print_step("3/3  render")
    render_video(Render(options.out, options.out / "video.mp4", steps=60))
    console().print(table(result))
    console().print(_summary(run, result))
    return 0


def _check(options: Demo) -> None:
    at_least(0, "--seed", options.seed)
    check_episodes(options.episodes)
    check_output_folder(options.out, "--out")


def _print_step(title: str) -> None:
    console().print(title, style="bold", highlight=False)


def _config(options: Demo) -> TrainConfig:
    config = replace(recipe("Lift", "sac"), seed=options.seed, out=options.out)
    if is_unfinished(options.out, config.steps):
        return replace(config, resume=True)
    remove_finished(options.out)
    return config


def _summary(run: RunResult, result: Evaluation) -> Table:
    minutes, seconds = divmod(round(run.seconds), 60)
    rate = result.success["success_held"]
    rows = {
        "trained": f"{run.env_steps:,} steps in {minutes}:{seconds:02} min",
        "success_held in stock robosuite": (
            f"{rate.rate:.1%} of {result.episodes} episodes "
            f"({rate.low:.1%} - {rate.high:.1%})"
        ),
        "training seeds": "1: the interval covers episodes only",
    }
    rows |= {what: str(run.folder / name) for name, what in FILES.items()}
    summary = Table(title="demo", title_style="bold", show_header=False)
    for name, text in rows.items():
        summary.add_row(name, Text(printable(text), overflow="fold"))
    return summary
