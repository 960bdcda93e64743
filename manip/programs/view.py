"""`manip view`: watch a policy in a window, MuJoCo's viewer."""

import os
import platform
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import torch
import tyro

from manip.errors import UserError, at_least, shown
from manip.evaluation.episode_recording import RecordedEpisode, first_state, record
from manip.programs import cli
from manip.sim.window import Window
from manip.training.baselines import Baseline
from manip.training.final_evaluation import (
    EvaluationOptions,
    episode_settings,
    load_policy_and_task,
)


@dataclass(frozen=True)
class View:
    """Watch episodes of a policy in a window, one after the other, until it is closed.

    The episodes are those of `manip evaluate --env native` with the same --seed. Drag
    to turn the view, scroll to zoom, double-click a body to see its name.
    """

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder, policy folder, checkpoint file, or name of a shipped policy (see
    `manip list`). With --policy, the task instead."""
    policy: Baseline | None = None
    """Policy that needs no training: the task's expert, random actions, or an untrained
    network."""
    robot: str = "Panda"
    """Robot arm with --policy; a trained policy has its own."""
    episode: int = 0
    """Number of the first episode: its index in episodes.csv."""
    seed: int = 0
    """Seed of the episodes' random streams."""
    speed: float = 1.0
    """Seconds of the episode in a second: 0.25 is slow motion."""


def main(arguments: Sequence[str]) -> int:
    """Show episodes until the window is closed."""
    options = cli.parse(View, arguments, "manip view")
    _check(options)
    torch.set_num_threads(1)
    policy, task = load_policy_and_task(options.run, options.policy, options.robot)
    evaluation = EvaluationOptions("native", 1, options.seed)
    settings = episode_settings(evaluation, policy, task)
    settings = replace(settings, first=options.episode)
    period = 1 / (policy.card.control_freq * options.speed)
    with closing(Window(first_state(settings).model())) as window:
        while window.open:
            (episode,) = record(policy, settings)
            _show(window, episode, period)
            settings = replace(settings, first=settings.first + 1)
    return 0


def _show(window: Window, episode: RecordedEpisode, period: float) -> None:
    for pose in episode.poses:
        began = time.monotonic()
        if not window.open:
            return
        window.show(pose)
        time.sleep(max(0.0, period - (time.monotonic() - began)))


def _check(options: View) -> None:
    at_least(0, "--episode", options.episode)
    at_least(0, "--seed", options.seed)
    if not 0.01 <= options.speed <= 100:
        raise UserError(f"--speed must be from 0.01 to 100, not {shown(options.speed)}")
    if platform.system() == "Linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise UserError(
            "there is no display (DISPLAY is not set) for a window: use "
            "`manip render`, which writes a video"
        )
