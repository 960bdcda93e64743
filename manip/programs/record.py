"""`manip record`: record episodes as a LeRobot, robomimic or Minari data set."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import torch
import tyro
from rich.console import Console
from rich.progress import Progress

from manip.cameras import CameraConfig, Quality
from manip.data.datasets import WRITERS, Format
from manip.data.recorder import record_round
from manip.data.stored_episode import Recording, StoredEpisode
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.make_batch import make_batch
from manip.envs.task import Task
from manip.errors import UserError, at_least
from manip.evaluation.runners import acting
from manip.io.option_ranges import NUMBER
from manip.io.output_paths import check_output_folder
from manip.io.printable import printable
from manip.observation import check_observation
from manip.programs import cli
from manip.training.baselines import AnyPolicy, Baseline
from manip.training.final_evaluation import check_episodes, load_policy_and_task

MOST_ENVS = 50
"""Environments that are recorded side by side."""

MOST_FAILURES = 20
"""Episodes, for each one requested, after which `--successful` gives up."""


@dataclass(frozen=True)
class Record:
    """Record episodes in exact physics, for other libraries and for `manip train
    --dataset` (docs/datasets.md).
    """

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder, policy folder, or name of a shipped policy (see `manip list`). With
    --policy, the task instead."""
    out: Path
    """Folder of the data set; new or empty."""
    policy: Baseline | None = None
    """Policy that needs no training, such as the task's expert: as for `manip
    evaluate`."""
    format: Format = "lerobot"
    """lerobot: LeRobotDataset v3; robomimic: HDF5 with states of the simulation;
    minari: Minari's HDF5. All need the extra `data`."""
    episodes: int = 200
    """Number of episodes."""
    successful: bool = False
    """Record only episodes that succeed at their end."""
    noise: float = 0.0
    """Largest standard deviation of noise on the actions (DART). It rises linearly from
    0 over the environments, of which there are 50 or fewer. The choice without noise is
    recorded, too, and is what `--algo bc` imitates."""
    robot: str = "Panda"
    """Robot arm with --policy; a trained policy has its own."""
    cameras: tuple[str, ...] = ()
    """Cameras whose images are recorded, by robosuite's names; those that the policy
    sees, unless given."""
    image_size: int = 84
    """Height and width of the images [pixel], if the policy sees none."""
    image_quality: Quality = "exact"
    """Images that are recorded. exact: robosuite's bytes; lean: several times faster,
    without reflections and with fewer triangles."""
    seed: int = 0
    """Seed of the episodes and of the noise."""


def main(arguments: Sequence[str]) -> int:
    """Record the episodes, and print where they are."""
    options = cli.parse(Record, arguments, "manip record")
    torch.set_num_threads(1)
    path = record(options)
    print(printable(f"{options.episodes} episodes in {path}"))
    return 0


def record(options: Record) -> Path:
    """Record the episodes that the options describe.

    Raises:
        UserError: an option is out of range, the folder is not empty, a library is
            missing, or too few episodes succeed.
    """
    _check(options)
    policy, task = load_policy_and_task(options.run, options.policy, options.robot)
    env = _env(options, policy, task)
    card = policy.card
    recording = Recording(
        task=card.task,
        robot=card.robot,
        controller=card.controller,
        control_freq=card.control_freq,
        actor=options.policy or f"{card.algo} policy, {card.env_steps} steps",
        observation=env.batch.observation_spec.to_dict(),
        seed=options.seed,
        noise=options.noise,
        image_quality=options.image_quality,
    )
    with Progress(console=Console(stderr=True), transient=True) as bar:
        running = bar.add_task(card.task, total=options.episodes)
        episodes = _episodes(options, env, lambda: bar.advance(running))
        with _removed_on_failure(options.out):
            return WRITERS[options.format](options.out, recording, episodes)


@contextmanager
def _removed_on_failure(folder: Path) -> Iterator[None]:
    """Leave no part of a data set behind in a folder that was empty."""
    existed = folder.is_dir()
    try:
        yield
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        if existed:
            folder.mkdir(exist_ok=True)
        raise


def _check(options: Record) -> None:
    check_episodes(options.episodes)
    at_least(0, "--seed", options.seed)
    cli.check_range("--image-size", options.image_size, 8, 512)
    if options.noise not in NUMBER:
        raise UserError(f"--noise must be {NUMBER}, not {options.noise}")
    check_output_folder(options.out, "--out")
    if options.out.is_dir() and any(options.out.iterdir()):
        raise UserError(f"--out {options.out} is not empty: name a new folder")


def _env(options: Record, policy: AnyPolicy, task: Task) -> TaskEnv:
    """Environments that give the policy's choice, cameras and states."""
    batch = make_batch(
        task,
        min(MOST_ENVS, options.episodes),
        robot=policy.card.robot_config,
        cameras=_cameras(options, policy.card.cameras),
        seed=options.seed,
    )
    check_observation(policy.card.observation, batch.observation_spec)
    return TaskEnv(batch, expert=acting(policy, batch))


def _cameras(options: Record, observed: CameraConfig | None) -> CameraConfig | None:
    """The cameras to record; those that a policy sees, without frames of the past."""
    if observed is None:
        sizes = options.image_size, options.image_quality
        return CameraConfig(options.cameras, *sizes, 1) if options.cameras else None
    if observed.frames > 1:
        raise UserError(
            f"the policy sees {observed.frames} frames of each camera, which data sets "
            "do not hold: record a policy that sees one, or the state"
        )
    if set(options.cameras) - set(observed.names):
        raise UserError(
            f"the policy sees {', '.join(observed.names)}: only these can be recorded"
        )
    return replace(observed, quality=options.image_quality)


def _episodes(
    options: Record, env: TaskEnv, advance: Callable[[], None]
) -> Iterator[StoredEpisode]:
    """The requested number of episodes, round by round.

    Raises:
        UserError: too few of them succeed.
    """
    torch.manual_seed(options.seed)
    written = tried = 0
    while True:
        for episode in record_round(env, options.noise):
            tried += 1
            if options.successful and not episode.success[-1]:
                continue
            yield episode
            advance()
            written += 1
            if written == options.episodes:
                return
        if tried >= MOST_FAILURES * options.episodes:
            raise UserError(
                f"only {written} of {tried} episodes succeeded: leave out --successful,"
                " or lower --noise"
            )
