"""Train until a task is learned, and evaluate the policies in stock robosuite."""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from manip.agents.policy import load_policy
from manip.benchmarks.peers import import_peer
from manip.benchmarks.time_to_success import TimedRun, held_in_stock
from manip.cluster.executors import finish_runs
from manip.cluster.job import JobResult
from manip.training.config import TrainConfig
from manip.training.recipes import recipe


def manip_runs(task: str, seeds: int, episodes: int) -> Iterator[TimedRun]:
    """Train with the recipe of SAC, one seed after another, each on all CPUs.

    The time is that of the whole run, from the construction of its environments to its
    last file, in a process that has compiled all code.

    Raises:
        UserError: a run failed.
    """
    run = recipe(task, "sac")
    with tempfile.TemporaryDirectory() as scratch:
        _train(replace(run, steps=1, eval_episodes=1, out=Path(scratch) / "compile"))
        for seed in range(seeds):
            Console(stderr=True).rule(f"manip, seed {seed} ({seed + 1} of {seeds})")
            yield _timed(
                replace(run, seed=seed, out=Path(scratch) / f"{seed}"), episodes
            )


def _timed(run: TrainConfig, episodes: int) -> TimedRun:
    start = time.monotonic()
    result = _train(run)
    seconds = time.monotonic() - start
    rate = held_in_stock(run.task, load_policy(run.folder), episodes, run.robot_config)
    return TimedRun("manip SAC", run.seed, seconds, result.env_steps, rate)


def _train(run: TrainConfig) -> JobResult:
    results = finish_runs([run], processes=1)
    if results is None:
        raise KeyboardInterrupt
    return results[0]


def sb3_runs(task: str, seeds: int, limit: float, episodes: int) -> Iterator[TimedRun]:
    """Run Stable-Baselines3's SAC on stock robosuite.

    A run lasts until an evaluation reaches the goal, or `limit` seconds. The time
    includes the construction of its environment.
    """
    learn = import_peer("task_sb3").learn
    console = Console(stderr=True)
    for seed in range(seeds):
        console.rule(f"Stable-Baselines3, seed {seed}, at most {limit / 60:g} min")
        yield learn(task, seed, limit, episodes)
