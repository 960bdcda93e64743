"""`manip render`: make a video of a policy."""

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro
from tensordict import TensorDictBase

from manip.agents.policy import Policy, load_policy
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task import Task
from manip.envs.task_registry import load_task_named_by
from manip.errors import UserError, at_least
from manip.evaluation.episodes import run_episodes
from manip.evaluation.runners import EpisodeSettings, make_env
from manip.io.output_paths import check_output
from manip.io.printable import printable
from manip.io.video import Caption, save_animation
from manip.programs import cli
from manip.sim.renderer import WORKSPACE, render_frames

Array = np.ndarray

SUFFIXES = (".mp4", ".gif")

MOST_EPISODES = 1000
"""Their states are stored until they are drawn."""

MOST_PIXELS = 4096
"""Width and height that H.264 decoders play."""


@dataclass(frozen=True)
class Render:
    """Make a video of a policy, off screen: with EGL, or else OSMesa."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder, policy folder, or name of a shipped policy (see `manip list`)."""
    out: Path = Path("video.mp4")
    """Video file to write: .mp4 or .gif."""
    episodes: int = 3
    """Number of episodes, one after the other in the video."""
    seed: int = 0
    """Seed of the episodes' random streams, the same as of `manip evaluate`."""
    camera: str = WORKSPACE
    """Camera: workspace, closeup, or one of the model's own (frontview, sideview,
    ...)."""
    width: int = 640
    """Width of the image [pixel]."""
    height: int = 480
    """Height of the image [pixel]."""
    steps: int | None = None
    """Control steps shown of each episode. All of them unless given."""
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
    """Run the episodes on the exact engine, then draw the recorded states.

    Raises:
        UserError: an option is out of range, the file cannot be written, nothing can
            draw here, or the task has no states to draw; all before the episodes.
    """
    _check(options)
    runs = [run for run in (options.before, options.run) if run is not None]
    policies = [load_policy(run) for run in runs]
    _check_comparable(policies)
    recorders = [_record(*each, options) for each in zip(runs, policies, strict=True)]
    rows = zip(*(each.frames(options) for each in recorders), strict=True)
    frames = (np.concatenate(row, axis=1) for row in rows)
    save_animation(options.out, frames, policies[-1].card.control_freq)


def _record(run: Path, policy: Policy, options: Render) -> "Recorder":
    """Run the episodes of a policy, after drawing one image."""
    if options.images and policy.card.cameras is None:
        raise UserError(f"the policy in {run} sees no images: drop --images")
    task = load_task_named_by(run, policy.card.task)
    env = make_env(_settings(options, policy, task), options.episodes)
    _draw_one(env, options)
    recorder = Recorder(env)
    run_episodes(env, policy, options.episodes, callback=recorder)
    return recorder


def _check_comparable(policies: Sequence[Policy]) -> None:
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
    cli.check_range("--width", options.width, 1, MOST_PIXELS)
    cli.check_range("--height", options.height, 1, MOST_PIXELS)
    at_least(1, "--steps", 1 if options.steps is None else options.steps)
    at_least(0, "--seed", options.seed)
    check_output(options.out, "--out", SUFFIXES)


def _draw_one(env: TaskEnv, options: Render) -> None:
    """Draw one image, which fails where camera, size or OpenGL do not work."""
    recorder = Recorder(env)
    recorder(env.reset())
    with closing(recorder.frames(options)) as frames:
        next(frames)
    env.batch.restart()


def _settings(options: Render, policy: Policy, task: Task) -> EpisodeSettings:
    return EpisodeSettings(
        task=task,
        robot=policy.card.robot_config,
        observation=policy.card.observation,
        cameras=policy.card.cameras,
        episodes=options.episodes,
        seed=options.seed,
        backend="native",
    )


class Recorder:
    """Record the states of environments during their episodes, and draw them later.

    Raises:
        UserError: the environments are not on the batch engine.
    """

    def __init__(self, env: TaskEnv) -> None:
        if not isinstance(env.batch, NativeBatch):
            raise UserError(
                f"{env.batch.task.name} is not stepped by the batch engine and cannot "
                "be rendered; `manip evaluate` measures its success"
            )
        self._batch = env.batch
        self._states: list[Array] = []
        self._success: list[Array] = []
        self._images: list[list[Array]] = []

    def __call__(self, state: TensorDictBase) -> None:
        """Record the present state of all environments."""
        self._states.append(self._batch.engine.states.copy())
        self._success.append(state["success"].squeeze(-1).numpy().copy())
        parts = self._batch.cameras.parts
        self._images.append([state[part.name].numpy() for part in parts])

    def frames(self, options: Render) -> Generator[Array, None, None]:
        """Images [H, W, 3] uint8 of all episodes, one after the other."""
        states = np.stack(self._states)[: options.steps]
        success = np.stack(self._success)[: options.steps]
        for env_id in range(self._batch.num_envs):
            captions = [
                Caption(_caption(env_id, step, bool(done)), bool(done))
                for step, done in enumerate(success[:, env_id])
            ]
            frames = render_frames(
                self._batch.engine.visual_model(states[0, env_id]),
                states[:, env_id, : self._batch.scene.visual.nq],
                options.camera,
                options.width,
                options.height,
                captions,
            )
            with closing(frames):
                for step, frame in enumerate(frames):
                    images = [image[env_id] for image in self._images[step]]
                    yield beside(frame, images) if options.images else frame


def beside(frame: Array, images: Sequence[Array]) -> Array:
    """Put images, one below the other, at the right of a frame.

    Args:
        frame: [H, W, 3] uint8.
        images: [S, S, 3 k] uint8 each, the bottom row first; the last 3 channels, the
            latest image, are shown.

    Returns:
        [H, W + H / number of images, 3] uint8; less than that many rows are black.
    """
    side = frame.shape[0] // len(images)
    column = np.zeros((frame.shape[0], side, 3), np.uint8)
    for number, image in enumerate(images):
        place = np.arange(side) * len(image) // side
        enlarged = image[::-1, :, -3:][place][:, place]
        column[number * side : (number + 1) * side] = enlarged
    return np.concatenate([frame, column], axis=1)


def _caption(env_id: int, step: int, success: bool) -> str:
    return f"episode {env_id + 1}   step {step}" + ("   SUCCESS" if success else "")
