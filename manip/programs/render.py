"""`manip render`: film a policy at work."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, cast

import numpy as np
import tyro
from tensordict import TensorDictBase

from manip.agents.policy import load_policy
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.make_batch import make_batch
from manip.envs.task_registry import load_task_named_by
from manip.errors import at_least
from manip.evaluation.episodes import run_episodes
from manip.io.video import Caption, save_animation
from manip.programs import cli
from manip.sim.renderer import WORKSPACE, render_frames

Array = np.ndarray


@dataclass(frozen=True)
class Render:
    """Film a policy at work, offscreen: EGL, else OSMesa, whichever works."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder, folder with a policy, or name of a shipped one (see `manip list`)."""
    out: Path = Path("video.mp4")
    """File to write: .mp4 or .gif."""
    episodes: int = 3
    """Number of episodes."""
    seed: int = 0
    """Seed of the episodes."""
    camera: str = WORKSPACE
    """Camera: workspace, or one of the model's own (frontview, sideview, ...)."""
    width: int = 640
    """Picture width [pixel]."""
    height: int = 480
    """Picture height [pixel]."""
    steps: int | None = None
    """Control steps filmed of each episode; all unless given."""


def main(arguments: Sequence[str]) -> int:
    """Film and say where the file lies."""
    options = cli.parse(Render, arguments, "manip render")
    film(options)
    print(options.out)
    return 0


def film(options: Render) -> None:
    """Run the episodes on the exact engine, then draw the recorded states."""
    for name in ("episodes", "width", "height"):
        at_least(1, f"--{name}", getattr(options, name))
    at_least(1, "--steps", 1 if options.steps is None else options.steps)
    at_least(0, "--seed", options.seed)
    policy = load_policy(options.run)
    card = policy.card
    task = load_task_named_by(options.run, card.task)
    env = TaskEnv(
        make_batch(task, options.episodes, robot=card.robot_config, seed=options.seed)
    )
    env.batch.check_layout(card.layout)
    recorder = Recorder(env)
    run_episodes(env, policy, options.episodes, watch=recorder)
    frames = recorder.frames(options)
    save_animation(options.out, frames, fps=card.control_freq)


class Recorder:
    """Keeps the worlds' states as they pass, and draws them afterwards."""

    def __init__(self, env: TaskEnv) -> None:
        self._batch = cast(NativeBatch, env.batch)
        self._states: list[Array] = []
        self._success: list[Array] = []

    def __call__(self, state: TensorDictBase) -> None:
        """Take in the worlds as they are now."""
        self._states.append(self._batch.engine.states.copy())
        self._success.append(state["success"].squeeze(-1).numpy().copy())

    def frames(self, options: Render) -> Iterator[Array]:
        """Pictures [H, W, 3] uint8 of all episodes, one after the other."""
        states = np.stack(self._states)[: options.steps]
        success = np.stack(self._success)[: options.steps]
        for world in range(self._batch.num_envs):
            captions = [
                Caption(_words(world, step, bool(done)), bool(done))
                for step, done in enumerate(success[:, world])
            ]
            yield from render_frames(
                self._batch.engine.visual_model(states[0, world]),
                states[:, world, : self._batch.scene.visual.nq],
                options.camera,
                options.width,
                options.height,
                captions,
            )


def _words(world: int, step: int, success: bool) -> str:
    return f"episode {world + 1}   step {step}" + ("   SUCCESS" if success else "")
