"""Evaluating a policy on its task, natively or where the task comes from."""

import multiprocessing
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Literal

import torch

from manip.cpus import usable_cpus
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.worker_pool import end_with_parent
from manip.envs.make_batch import make_batch
from manip.evaluation.episodes import Episode, Policy, run_episodes
from manip.robot_config import RobotConfig
from manip.sim.scene import Fidelity

Where = Literal["stock", "native"]
Layout = Mapping[str, Sequence[int]]
"""Observation part -> start and stop in the observation that a policy needs."""

Progress = Callable[[int], None]
"""Called with the number of episodes that have just ended."""


def native_episodes(
    task: str,
    policy: Policy,
    episodes: int,
    seed: int,
    robot: RobotConfig,
    fidelity: Fidelity,
    layout: Layout | None = None,
) -> list[Episode]:
    """Run episodes on the batch engine, each in a world of its own.

    Raises:
        UserError: the layout is given, and is not that of the task's observation.
    """
    batch = make_batch(task, episodes, robot=robot, fidelity=fidelity, seed=seed)
    env = TaskEnv(batch)
    if layout is not None:
        env.batch.check_layout(layout)
    return run_episodes(env, policy, episodes)


def stock_episodes(
    task: str,
    policy: Policy,
    episodes: int,
    seed: int,
    robot: RobotConfig,
    progress: Progress = lambda _: None,
    layout: Layout | None = None,
) -> list[Episode]:
    """Run episodes in `robosuite.make(...)`, or in the library that the task is of.

    There is a process for each usable CPU.
    Episode e starts from seed + e, with a hard reset as robosuite's defaults have it,
    so that sizes which robosuite samples when it builds a model vary, too.

    Raises:
        UserError: the layout is given, and is not that of the task's observation.
    """
    seeds = range(seed, seed + episodes)
    workers = min(usable_cpus(), episodes)
    if workers == 1:
        _open_worker(policy, task, robot, layout)
        return list(_counted(map(_episode, seeds), progress))
    pool = ProcessPoolExecutor(
        workers,
        multiprocessing.get_context("spawn"),
        _open_worker,
        (policy, task, robot, layout),
    )
    with pool:
        return list(_counted(pool.map(_episode, seeds), progress))


def timed(run: Callable[[], Sequence[Episode]]) -> tuple[Sequence[Episode], float]:
    """The episodes of a run, and the seconds it took."""
    began = time.monotonic()
    return run(), time.monotonic() - began


def _counted(episodes: Iterator[Episode], progress: Progress) -> Iterator[Episode]:
    for episode in episodes:
        progress(1)
        yield episode


_worker: dict[str, tuple[TaskEnv, Policy, Layout | None]] = {}


def _open_worker(
    policy: Policy, task: str, robot: RobotConfig, layout: Layout | None
) -> None:
    end_with_parent()
    torch.set_num_threads(1)
    batch = make_batch(task, backend="stock", robot=robot, hard_reset=True)
    env = TaskEnv(batch)
    _worker["now"] = (env, policy, layout)


def _episode(seed: int) -> Episode:
    env, policy, layout = _worker["now"]
    if layout is not None:
        env.batch.check_layout(layout)
    env.set_seed(seed)
    return run_episodes(env, policy, 1)[0]
