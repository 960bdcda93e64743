"""Evaluate a policy on a task, on the batch engine or in stock robosuite."""

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch

from manip.cameras import CameraConfig
from manip.cpus import usable_cpus
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.worker_pool import end_with_parent
from manip.envs.episode_streams import EVALUATION, Purpose
from manip.envs.make_batch import Backend, make_batch
from manip.envs.perturbation import Perturbations
from manip.envs.task import Task
from manip.envs.task_batch import TaskBatch
from manip.evaluation.episode_details import DetailTracker
from manip.evaluation.episodes import (
    Callback,
    Episode,
    Penalty,
    Policy,
    run_episodes,
)
from manip.evaluation.policy_blocks import in_blocks
from manip.looks import Looks
from manip.observation import check_observation
from manip.robot_config import RobotConfig
from manip.sim.robosuite_log import quiet_robosuite
from manip.sim.scene import Fidelity, Scene
from manip.sim.warp.library import Device

Array = np.ndarray

Progress = Callable[[int], None]
"""Called with the number of episodes that have just ended."""


class StepPenalties(Protocol):
    """Penalises control steps by their visible measures; it can be pickled."""

    def penalties(self, measures: Array, names: Sequence[str]) -> Array:
        """[...]: penalties of steps with measures [..., M] of these names."""


@runtime_checkable
class ActsInBatch(Protocol):
    """A policy that needs more than the observation, such as a task's expert."""

    def acting_in(self, batch: TaskBatch) -> Policy:
        """The policy for a batch whose next episodes are about to begin."""


@dataclass(frozen=True)
class EpisodeSettings:
    """The episodes of an evaluation; they depend on nothing else.

    Attributes:
        task: the task, or its name.
        robot: arm, controller and control frequency.
        observation: the parts that the policy needs, from its card; they are compared
            with the environment's unless None.
        cameras: cameras whose images the policy needs; None for none.
        episodes: number of episodes.
        first: number of the first one; `Episode.index` counts on from it.
        seed: of their random streams; no two seeds share an episode.
        purpose: episodes of different purposes differ, so that a policy is never
            evaluated on the starts that it was trained or chosen on.
        backend: "native", the batch engine; "stock", robosuite itself, or the library
            that the task comes from; "warp", MuJoCo Warp.
        fidelity: physics of the native and the warp backend.
        device, njmax, nconmax: as in `WarpBatch`, for the warp backend.
        taste: penalises the steps; None for nothing.
        looks: suite of fixed looks of the native backend's images (`manip.looks`);
            None for robosuite's own look.
        perturbations: what differs from the nominal task.
        details: whether `Episode.details` are recorded; the motion of the robot by the
            native backend only.
    """

    task: str | Task
    robot: RobotConfig
    observation: Any = None
    cameras: CameraConfig | None = None
    episodes: int = 100
    seed: int = 0
    purpose: Purpose = EVALUATION
    backend: Backend = "stock"
    fidelity: Fidelity = "exact"
    taste: StepPenalties | None = None
    looks: str | Looks | None = None
    perturbations: Perturbations = ()
    details: bool = False
    first: int = 0
    device: Device | None = None
    njmax: int | None = None
    nconmax: int | None = None


def evaluate_policy(
    policy: Policy | ActsInBatch,
    settings: EpisodeSettings,
    progress: Progress = lambda _: None,
    processes: int | None = None,
    scene: Scene | None = None,
) -> list[Episode]:
    """Run the episodes: stock ones in several processes, others in one batch.

    Stock episodes begin with robosuite's hard reset (its default), so that sizes which
    it samples when it builds a model vary, too.

    Args:
        policy: chooses the actions.
        settings: the episodes.
        progress: called with the number of episodes that have just ended.
        processes: processes that run stock episodes, one for each usable CPU unless
            given; with 1, this very process. The number changes the speed only.
        scene: compiled scene of native episodes, instead of building one.

    Raises:
        UserError: the environment lacks a part of the observation.
        ChildProcessError: a process has died.
    """
    if settings.backend != "stock":
        env = make_env(settings, settings.episodes, scene)
        results = run_settings(env, policy, settings, settings.episodes)
        progress(len(results))
        return results
    episodes = _stock_episodes(policy, settings, processes or usable_cpus())
    return list(_counted(episodes, progress))


def make_env(
    settings: EpisodeSettings, num_envs: int = 1, scene: Scene | None = None
) -> TaskEnv:
    """Environments whose next episodes are the first of the settings.

    `scene` is a compiled scene for the native or the warp backend, instead of building
    one.

    Raises:
        UserError: the environment lacks a part of the observation.
    """
    options: dict[str, Any] = {"hard_reset": True}
    if settings.backend != "stock":
        options = {"fidelity": settings.fidelity, "motion": settings.details}
        options |= {"scene": scene} if scene else {}
        options["first_env"] = settings.first
    if settings.backend == "warp":
        options |= {k: getattr(settings, k) for k in ("device", "njmax", "nconmax")}
    batch = make_batch(
        settings.task,
        num_envs,
        backend=settings.backend,
        robot=settings.robot,
        seed=settings.seed,
        purpose=settings.purpose,
        cameras=settings.cameras,
        looks=settings.looks or 0.0,
        perturbations=settings.perturbations,
        **options,
    )
    if settings.observation is not None:
        check_observation(settings.observation, batch.observation_spec)
    motion = settings.details and isinstance(batch, NativeBatch)
    return TaskEnv(batch, measures=settings.taste is not None, motion=motion)


def acting(policy: Policy | ActsInBatch, batch: TaskBatch) -> Policy:
    """The policy for a batch whose next episodes are about to begin."""
    return policy.acting_in(batch) if isinstance(policy, ActsInBatch) else policy


def run_settings(
    env: TaskEnv,
    policy: Policy | ActsInBatch,
    settings: EpisodeSettings,
    episodes: int,
    callback: Callback | None = None,
) -> list[Episode]:
    """Run episodes; penalties and details are recorded if the settings say so.

    An episode does not depend on how many run side by side, to the last bit.
    """
    act = acting(policy, env.batch)
    if settings.backend != "stock" and not isinstance(policy, ActsInBatch):
        act = in_blocks(act)
    penalty: Penalty | None = None
    if settings.taste:
        names = env.batch.measure_names
        penalty = partial(settings.taste.penalties, names=names)
    details = DetailTracker(env) if settings.details else None
    results = run_episodes(env, act, episodes, callback, penalty, details)
    return [replace(each, index=settings.first + each.index) for each in results]


def _stock_episodes(
    policy: Policy | ActsInBatch, settings: EpisodeSettings, processes: int
) -> Iterator[Episode]:
    processes = min(processes, settings.episodes)
    if processes == 1:
        env = make_env(settings)
        for index in _numbers(settings):
            yield _stock_episode(env, policy, settings, index)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, _start_worker, (policy, settings))
    try:
        with interrupts_blocked():
            episodes = pool.map(_episode_of_worker, _numbers(settings))
        yield from episodes
    except BrokenProcessPool as error:
        raise ChildProcessError(
            "a process that ran episodes has died: is there too little memory?"
        ) from error
    finally:
        _end(pool)


def _numbers(settings: EpisodeSettings) -> range:
    return range(settings.first, settings.first + settings.episodes)


def _stock_episode(
    env: TaskEnv, policy: Policy | ActsInBatch, settings: EpisodeSettings, index: int
) -> Episode:
    """Run episode `index` of the settings, independent of earlier episodes."""
    env.batch.restart(episode=index)
    return replace(run_settings(env, policy, settings, 1)[0], index=index)


def _end(pool: ProcessPoolExecutor) -> None:
    """End the workers at once: episodes that have begun may take a minute."""
    for process in (pool._processes or {}).values():
        process.terminate()  # as ProcessPoolExecutor.terminate_workers of Python 3.14
    pool.shutdown(cancel_futures=True)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C here and, for good, in processes that are started inside.

    The terminal sends it to all processes; only the parent is to handle it, even while
    its workers are still importing.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_worker: dict[str, Any] = {}


def _start_worker(policy: Policy | ActsInBatch, settings: EpisodeSettings) -> None:
    """Prepare a process; the environment is built later, where errors are returned."""
    end_with_parent()
    quiet_robosuite()
    torch.set_num_threads(1)
    _worker.update(policy=policy, settings=settings)


def _episode_of_worker(index: int) -> Episode:
    if "env" not in _worker:
        _worker["env"] = make_env(_worker["settings"])
    return _stock_episode(_worker["env"], _worker["policy"], _worker["settings"], index)


def _counted(episodes: Iterable[Episode], progress: Progress) -> Iterator[Episode]:
    for episode in episodes:
        progress(1)
        yield episode
