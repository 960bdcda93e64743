"""`manip train`: train a policy from a tuned recipe."""

import contextlib
import io
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from manip.envs.external_task import ExternalTask
from manip.envs.task_registry import load_task, load_task_named_by
from manip.errors import UserError, check_choice, unknown
from manip.programs import cli
from manip.robot_config import ROBOTS
from manip.training.config import ALGORITHMS, TrainConfig, recipe, recorded
from manip.training.trainer import Trainer


@dataclass(frozen=True)
class _Start:
    """The options that choose the recipe which sets all others."""

    task: str = "Lift"
    algo: str = "sac"
    robot: str | None = None
    out: Path | None = None
    resume: bool = False


def main(arguments: Sequence[str]) -> int:
    """Train; 0 when the run ended, 3 when it was stopped and saved on the way."""
    config = cli.parse(TrainConfig, arguments, "manip train", _defaults(arguments))
    task = load_task(config.task)
    check_choice("robot", config.robot, ROBOTS)
    if isinstance(task, ExternalTask):
        print(f"manip: {task.notice}", file=sys.stderr)
    finished = Trainer(config).run()
    if finished:
        print(f"trained policy: {config.folder / 'policy'}", file=sys.stderr)
    return 0 if finished else 3


def _defaults(arguments: Sequence[str]) -> TrainConfig:
    """The recipe of the task, algorithm and arm; or the options of a run to resume."""
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            start, _ = tyro.cli(
                _Start, args=list(arguments), return_unknown_args=True, add_help=False
            )
        except SystemExit:
            return TrainConfig()  # parsing all options says what is wrong
    if start.resume:
        return _recorded(start.out)
    if start.algo not in ALGORITHMS:
        raise unknown("algorithm", start.algo, ALGORITHMS)
    load_task(start.task)
    return recipe(start.task, start.algo, start.robot)


def _recorded(out: Path | None) -> TrainConfig:
    path = (out or Path()) / "config.yaml"
    if out is None or not path.is_file():
        raise UserError(f"--resume needs --out with a run folder; there is no {path}")
    config = replace(recorded(out), out=out, resume=True)
    load_task_named_by(out, config.task)
    return config
