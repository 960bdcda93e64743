"""`manip render`: make a video or stills of a policy."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import torch
import tyro

from manip.envs.task import Task
from manip.errors import UserError, at_least, shown
from manip.evaluation.episode_recording import RecordedEpisode, first_state, record
from manip.evaluation.runners import EpisodeSettings
from manip.io.output_paths import check_output
from manip.io.printable import printable
from manip.programs import cli
from manip.programs.film import Film, first_image, save_film, save_stills
from manip.sim.renderer import WORKSPACE, OwnView
from manip.training.baselines import AnyPolicy, Baseline
from manip.training.final_evaluation import (
    EvaluationOptions,
    episode_settings,
    load_policy_and_task,
)

STILLS = ".png"
SUFFIXES = (".mp4", ".gif", STILLS)

MOST_EPISODES = 1000
"""Their states are stored until they are drawn."""

MOST_PIXELS = 4096
"""Width and height that H.264 decoders play."""

SEARCHED = 100
"""Episodes among which --failures looks for failed ones, those of `manip evaluate`."""


@dataclass(frozen=True)
class Render:
    """Make a video of a policy, off screen: with EGL, or else OSMesa.

    The episodes are those of `manip evaluate` with the same --env and --seed.
    """

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder, policy folder, checkpoint file, or name of a shipped policy (see
    `manip list`). With --policy, the task instead."""
    out: Path = Path("video.mp4")
    """File to write: .mp4 or .gif; .png for stills in one image, a row per episode."""
    episodes: int = 3
    """Number of episodes, one after the other in the video."""
    episode: int | None = None
    """Number of the only episode to show: its index in episodes.csv."""
    failures: int = 0
    """Show so many episodes that failed (not success_held), of the first 100."""
    seed: int = 0
    """Seed of the episodes' random streams, the same as of `manip evaluate`."""
    env: Literal["native", "stock"] = "native"
    """Backend that simulates the episodes. native: the batch engine with exact physics;
    stock: robosuite itself, slower."""
    policy: Baseline | None = None
    """Policy that needs no training: the task's expert, random actions, or an untrained
    network."""
    robot: str = "Panda"
    """Robot arm with --policy; a trained policy has its own."""
    camera: tuple[str, ...] = (WORKSPACE,)
    """Cameras, side by side: workspace, closeup, or the model's own (frontview,
    sideview, ...)."""
    view: tuple[float, ...] = ()
    """Camera of your own instead: the point it looks at, x y z [m], its distance [m],
    and if you like its azimuth and elevation [degree]: 0 0 0.9 1.2 180 -20."""
    width: int = 640
    """Width of each camera's image [pixel]."""
    height: int = 480
    """Height of the image [pixel]."""
    steps: int | None = None
    """Control steps shown of each episode. All of them unless given."""
    fps: float | None = None
    """Frames per second of the video. One frame for each control step unless given."""
    speed: float = 1.0
    """Seconds of the episode in a second of the video: 0.25 is slow motion."""
    stills: int = 5
    """Stills of each episode in a .png file, from its start to its end."""
    before: Path | None = None
    """Another policy for the same task, shown at the left in the same episodes."""
    images: bool = False
    """Show the images that the policy sees beside each frame, enlarged. They make the
    video wider."""


def main(arguments: Sequence[str]) -> int:
    """Make the video and print its path."""
    options = cli.parse(Render, arguments, "manip render")
    torch.set_num_threads(1)
    render_video(options)
    print(printable(str(options.out)))
    return 0


def render_video(options: Render) -> None:
    """Run the episodes on the exact engine or in stock, then draw the recorded states.

    Raises:
        UserError: an option is out of range, the file cannot be written, nothing can
            draw here, or the task has no states to draw; all before the episodes.
    """
    _check(options)
    loaded = [load_policy_and_task(options.run, options.policy, options.robot)]
    if options.before:
        loaded.insert(0, load_policy_and_task(options.before, None, options.robot))
    policies = [policy for policy, _ in loaded]
    _check_comparable(policies)
    film = _film(options, policies)
    settings = [_settings(options, policy, task) for policy, task in loaded]
    for policy, each in zip(policies, settings, strict=True):
        if options.images and policy.card.cameras is None:
            raise UserError(f"the policy {options.run} sees no images: drop --images")
        first_image(first_state(each), film)
    rows = [record(*each) for each in zip(policies, settings, strict=True)]
    if options.failures:
        rows = _failed(rows, options)
    if options.out.suffix == STILLS:
        save_stills(options.out, rows, film, options.stills)
    else:
        save_film(options.out, rows, film)


def _failed(
    rows: list[list[RecordedEpisode]], options: Render
) -> list[list[RecordedEpisode]]:
    """The first episodes in which the policy, the last of the rows, failed."""
    failed = [i for i, each in enumerate(rows[-1]) if not each.episode.success_held]
    if not failed:
        raise UserError(
            f"no episode of {len(rows[-1])} failed: try another --seed than "
            f"{options.seed}, or --episode"
        )
    return [[row[index] for index in failed[: options.failures]] for row in rows]


def _film(options: Render, policies: Sequence[AnyPolicy]) -> Film:
    titles = ("before   ", "after   ") if options.before else ("",)
    control_freq = policies[-1].card.control_freq
    return Film(
        cameras=(OwnView(*options.view),) if options.view else options.camera,
        width=options.width,
        height=options.height,
        control_freq=control_freq,
        fps=options.fps or control_freq,
        speed=options.speed,
        steps=options.steps,
        images=options.images,
        titles=titles,
    )


def _check_comparable(policies: Sequence[AnyPolicy]) -> None:
    names = [policy.card.task for policy in policies]
    if names[0] != names[-1]:
        raise UserError(
            f"--before is a policy for {names[0]}, and the other one for {names[-1]}: "
            "name two policies for one task"
        )
    before, after = (policies[i].card.control_freq for i in (0, -1))
    if before != after:
        raise UserError(
            f"--before acts at {before} Hz, and the other policy at {after} Hz: their "
            "frames do not belong together; name two policies of one frequency"
        )


def _check(options: Render) -> None:
    cli.check_range("--episodes", options.episodes, 1, MOST_EPISODES)
    cli.check_range("--failures", options.failures, 0, SEARCHED)
    cli.check_range("--stills", options.stills, 1, 100)
    cli.check_range("--width", options.width, 1, MOST_PIXELS)
    cli.check_range("--height", options.height, 1, MOST_PIXELS)
    at_least(1, "--steps", 1 if options.steps is None else options.steps)
    at_least(0, "--seed", options.seed)
    at_least(0, "--episode", options.episode or 0)
    if options.episode is not None and options.failures:
        raise UserError("--episode shows one episode: drop --failures")
    fps = 20.0 if options.fps is None else options.fps
    for name, value in (("--fps", fps), ("--speed", options.speed)):
        if not 0.01 <= value <= 1000:
            raise UserError(f"{name} must be from 0.01 to 1000, not {shown(value)}")
    if not options.camera:
        raise UserError("--camera must name one camera or more")
    if len(options.view) not in (0, 4, 5, 6):
        raise UserError(
            "--view must be four to six numbers, x y z distance azimuth elevation, "
            f"not {len(options.view)}"
        )
    check_output(options.out, "--out", SUFFIXES)


def _settings(options: Render, policy: AnyPolicy, task: Task) -> EpisodeSettings:
    episodes = SEARCHED if options.failures else options.episodes
    evaluation = EvaluationOptions(options.env, episodes, options.seed)
    settings = episode_settings(evaluation, policy, task)
    if options.episode is None:
        return settings
    return replace(settings, first=options.episode, episodes=1)
