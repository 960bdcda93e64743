"""`manip train`: train a policy from a tuned recipe."""

import contextlib
import io
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from manip.envs.backends.external_batch import ExternalTask
from manip.envs.task_registry import check_origin, load_task
from manip.errors import UserError, check_choice
from manip.programs import cli
from manip.robot_config import ROBOTS
from manip.training.config import (
    TrainConfig,
    recipe,
    recorded,
    scales_other_actions,
)
from manip.training.trainer import Trainer


@dataclass(frozen=True)
class _Start:
    """The options that choose the recipe which sets all others."""

    task: str = "Lift"
    algo: str = "sac"
    robot: str | None = None
    controller: str | None = None
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
    load_task(start.task)
    if scales_other_actions(start.task, start.algo, start.controller):
        print(
            f"manip: the recipe's action_scale is not used with {start.controller}",
            file=sys.stderr,
        )
    return recipe(start.task, start.algo, start.robot, start.controller)


def _recorded(out: Path | None) -> TrainConfig:
    path = (out or Path()) / "config.yaml"
    if out is None or not path.is_file():
        raise UserError(f"--resume needs --out with a run folder; there is no {path}")
    config = replace(recorded(out), out=out, resume=True)
    check_origin(config.task, out)
    return config
