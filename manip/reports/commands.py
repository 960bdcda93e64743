"""The commands that repeat what a report shows."""

import shlex
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from manip.evaluation.runners import EpisodeSettings
from manip.reports.run_record import RunRecord
from manip.training.config import TrainConfig
from manip.training.recipes import recipe

_CHOICE = ("task", "algo", "robot", "controller", "observe")
"""Options that choose the recipe, which sets all others."""

_PLACE = ("out", "resume")


def train_command(config: TrainConfig) -> str:
    """The shortest `manip train` with these options: those that the recipe lacks."""
    tuned = recipe(
        config.task, config.algo, config.robot, config.controller, config.observe
    )
    words = ["manip", "train", "--task", config.task, "--algo", config.algo]
    plain = recipe(config.task, config.algo)
    for name in _CHOICE[2:]:
        if getattr(config, name) != getattr(plain, name):
            words += _words(name, getattr(config, name))
    words += ["--seed", str(config.seed)]
    for name, value in changed_options(config, tuned):
        words += _words(name, value)
    words += ["--out", str(config.folder)]
    return shlex.join(words)


def changed_options(
    config: Any, tuned: Any, prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Names and values of options, nested ones as agent.gamma, that differ."""
    for field in fields(config):
        value, other = getattr(config, field.name), getattr(tuned, field.name)
        name = f"{prefix}{field.name}"
        if is_dataclass(value) and type(value) is type(other):
            yield from changed_options(value, other, f"{name}.")
        elif value != other and name not in (*_CHOICE, *_PLACE, "seed"):
            yield name, value


def evaluate_commands(record: RunRecord, settings: EpisodeSettings, shown: int) -> str:
    """Commands that repeat the evaluation, one a line, and draw the episode `shown`."""
    run = shlex.quote(str(record.path))
    among = f"--episodes {settings.episodes} --seed {settings.seed}"
    lines = [f"manip evaluate {run} {among}"]
    if settings.backend == "native":
        drawn = f"--episode {shown} --seed {settings.seed} --out episode.mp4"
        lines = [
            f"manip evaluate {run} --env native {among}",
            *lines,
            f"manip render {run} {drawn}",
        ]
    return "\n".join(lines)


def _words(name: str, value: Any) -> list[str]:
    option = "--" + name.replace("_", "-")
    if isinstance(value, bool):
        head, dot, last = option.removeprefix("--").rpartition(".")
        return [option if value else f"--{head}{dot}no-{last}"]
    if isinstance(value, tuple | list):
        return [option, *map(str, value)]
    return [option, str(value)]
