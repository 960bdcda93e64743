"""Evaluate a trained policy over many episodes, into one record."""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from manip.agents.policy import Policy, load_policy
from manip.cameras import CameraConfig, Quality
from manip.envs.make_batch import Backend
from manip.envs.task import Task
from manip.envs.task_registry import load_task_named_by
from manip.errors import UserError, at_least
from manip.evaluation.episode_table import motion_summary
from manip.evaluation.episodes import Episode
from manip.evaluation.report import Evaluation, summarise
from manip.evaluation.runners import EpisodeSettings, Progress, evaluate_policy
from manip.preferences.tastes import load_taste
from manip.sim.scene import Fidelity
from manip.sim.warp.library import Device
from manip.training.baselines import AnyPolicy, Baseline, load_baseline
from manip.training.checkpoint_policy import is_checkpoint, policy_of_checkpoint
from manip.versions import versions

MOST_EPISODES = 100_000
"""Native episodes run side by side, in memory."""


@dataclass(frozen=True)
class EvaluationOptions:
    """The episodes of an evaluation, and the processes that run them.

    Attributes:
        env: backend that simulates the episodes.
        episodes: their number.
        seed: of their random streams.
        fidelity: physics of the native engine.
        processes: processes that run stock episodes, one for each usable CPU unless
            given; the number changes the speed only.
        taste: of the task, whose penalty is measured; None for none.
        looks: suite of looks, see `manip.looks`; None for robosuite's own look.
        image_quality: of the native engine's images.
        details: whether the episodes have `Episode.details`.
        device, njmax, nconmax: as in `WarpBatch`, for the warp backend.
    """

    env: Backend = "stock"
    episodes: int = 100
    seed: int = 0
    fidelity: Fidelity = "exact"
    processes: int | None = None
    taste: str | None = None
    looks: str | None = None
    image_quality: Quality = "exact"
    details: bool = False
    device: Device | None = None
    njmax: int | None = None
    nconmax: int | None = None


def load_policy_and_task(
    name: Path, kind: Baseline | None, robot: str
) -> tuple[AnyPolicy, Task]:
    """As `load_run`; of a kind that needs no training, as `load_baseline`."""
    return load_baseline(kind, str(name), robot) if kind else load_run(name)


def load_run(run: Path) -> tuple[Policy, Task]:
    """The policy of a run, policy folder, checkpoint or shipped name, and its task.

    Raises:
        UserError: there is no such policy or task.
    """
    if is_checkpoint(run):
        return policy_of_checkpoint(run)
    policy = load_policy(run)
    return policy, load_task_named_by(run, policy.card.task)


def evaluate_on_task(
    policy: AnyPolicy,
    task: Task,
    options: EvaluationOptions,
    progress: Progress = lambda _: None,
) -> Evaluation:
    """Run the episodes and summarise them, as `measure_on_task`."""
    return measure_on_task(policy, task, options, progress).evaluation


class Measured(NamedTuple):
    """An evaluation, and its episodes in any order."""

    evaluation: Evaluation
    episodes: list[Episode]


def measure_on_task(
    policy: AnyPolicy,
    task: Task,
    options: EvaluationOptions,
    progress: Progress = lambda _: None,
) -> Measured:
    """Run the episodes and summarise them.

    Args:
        policy: chooses the actions.
        task: that of the policy.
        options: the episodes.
        progress: called with the number of episodes that have just ended.

    Raises:
        UserError: the task lacks a part that the policy observes, or has no such taste.
    """
    settings = episode_settings(options, policy, task)
    began = time.monotonic()
    episodes = evaluate_policy(policy, settings, progress, options.processes)
    result = Evaluation(
        **evaluated(policy, settings),
        purpose=settings.purpose.name.lower(),
        env_steps_trained=policy.card.env_steps,
        **summarise(episodes, task.milestone_names),
        seconds=time.monotonic() - began,
        versions=versions(),
        taste=options.taste,
        looks=options.looks,
        image_quality=settings.cameras.quality if settings.cameras else None,
        motion=motion_summary(episodes, policy.card.robot),
    )
    return Measured(result, episodes)


def evaluated(policy: AnyPolicy, settings: EpisodeSettings) -> dict[str, Any]:
    """The fields of `EvaluatedPolicy`."""
    return {
        "task": policy.card.task,
        "robot": policy.card.robot,
        "algo": policy.card.algo,
        "env": settings.backend,
        "fidelity": settings.fidelity,
        "episodes": settings.episodes,
        "seed": settings.seed,
    }


def check_episodes(episodes: int, least: int = 1) -> None:
    """Raise `UserError` unless --episodes is from `least` to `MOST_EPISODES`."""
    at_least(least, "--episodes", episodes)
    if episodes > MOST_EPISODES:
        raise UserError(f"--episodes must be at most {MOST_EPISODES}, not {episodes}")


def episode_settings(
    options: EvaluationOptions, policy: AnyPolicy, task: Task
) -> EpisodeSettings:
    """The episodes of an evaluation of a policy.

    Raises:
        UserError: the policy sees no images, but options are about them.
    """
    return EpisodeSettings(
        task=task,
        robot=policy.card.robot_config,
        observation=policy.card.observation,
        cameras=_cameras(options, policy),
        episodes=options.episodes,
        seed=options.seed,
        backend=options.env,
        fidelity="exact" if options.env == "stock" else options.fidelity,
        taste=load_taste(policy.card.task, options.taste) if options.taste else None,
        looks=options.looks,
        details=options.details,
        device=options.device,
        njmax=options.njmax,
        nconmax=options.nconmax,
    )


def _cameras(options: EvaluationOptions, policy: AnyPolicy) -> CameraConfig | None:
    """The cameras of a policy, in the quality of the options."""
    cameras = policy.card.cameras
    varied = options.looks or options.image_quality != "exact"
    if varied and (cameras is None or options.env == "stock"):
        raise UserError(
            "--looks and --image-quality are of images that the native engine draws: "
            "name a policy that sees cameras, and --env native"
        )
    return cameras and replace(cameras, quality=options.image_quality)
