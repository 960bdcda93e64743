"""The main job in one command: train, evaluate in stock robosuite, film, plot."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from manip.errors import UserError
from manip.evaluation.learning_curve import plot_learning_curve
from manip.evaluation.report import Evaluation, table
from manip.io.atomic_files import write_text
from manip.programs import cli
from manip.programs.evaluate import Evaluate, evaluate
from manip.programs.render import Render, film
from manip.training.checkpoint import Checkpoints
from manip.training.config import TrainConfig, recipe, recorded
from manip.training.run import RunResult, train
from manip.training.run_logs import read_metrics
from manip.training.terminal import TerminalProgress


@dataclass(frozen=True)
class Demo:
    """Train a Panda to lift a cube with SAC, prove it in stock robosuite, film it.

    An interrupted demo goes on where it stopped; a finished one starts anew.
    """

    out: Path = Path("runs/demo")
    """Folder for everything that the demo makes."""
    seed: int = 0
    """Seed of the training."""
    episodes: int = 100
    """Episodes of the evaluation in stock robosuite."""


def main(arguments: Sequence[str]) -> int:
    """Run the demo; 0 when it came to its end."""
    options = cli.parse(Demo, arguments, "demo")
    console = Console()
    console.rule("1/3  train: Lift, Panda, SAC")
    with TerminalProgress() as progress:
        run = train(_config(options), callback=progress)
    if not run.finished:
        return 3
    console.rule(f"2/3  evaluate: {options.episodes} episodes in stock robosuite")
    result = evaluate(Evaluate(options.out, "stock", options.episodes))
    write_text(options.out / "eval.json", result.to_json())
    console.rule("3/3  film and plot")
    film(Render(options.out, options.out / "video.mp4", steps=60))
    curve = options.out / "learning_curve.png"
    title = f"Lift, Panda, SAC, seed {options.seed}"
    plot_learning_curve(read_metrics(options.out / "metrics.csv"), title, curve)
    console.print(table(result))
    console.print(_summary(run, result))
    return 0


def _config(options: Demo) -> TrainConfig:
    config = replace(recipe("Lift", "sac"), seed=options.seed, out=options.out)
    if _unfinished(options.out, config.steps):
        return replace(config, resume=True)
    _clear(options.out)
    return config


def _clear(folder: Path) -> None:
    """Delete an earlier demo, and nothing else.

    Raises:
        UserError: the folder holds something that is not a run.
    """
    if not folder.exists():
        return
    if any(folder.iterdir()) and not (folder / "config.yaml").is_file():
        raise UserError(f"{folder} is not empty and holds no run: choose another --out")
    shutil.rmtree(folder)


def _unfinished(folder: Path, steps: int) -> bool:
    if not Checkpoints(folder).exist():
        return False
    steps_before = recorded(folder).steps
    rows = read_metrics(folder / "metrics.csv")
    done = int(rows[-1]["env_steps"]) if rows else 0
    return bool(steps_before == steps and done < steps)


def _summary(run: RunResult, result: Evaluation) -> Table:
    shown = Table(title="demo", title_style="bold", show_header=False)
    minutes, seconds = divmod(round(run.seconds), 60)
    held = result.success["success_held"]
    shown.add_row(
        "trained", f"{run.env_steps:,} steps in {minutes}:{seconds:02} min"
    )
    shown.add_row(
        "held success in stock robosuite",
        f"{held.rate:.1%} of {result.episodes} episodes "
        f"({held.low:.1%} - {held.high:.1%})",
    )
    for name, what in _PARTS.items():
        shown.add_row(what, str(run.folder / name))
    return shown


_PARTS = {
    "policy": "policy",
    "eval.json": "evaluation",
    "video.mp4": "video",
    "learning_curve.png": "learning curve",
    "metrics.csv": "metrics (TensorBoard: tensorboard/)",
    "config.yaml": "configuration",
}
