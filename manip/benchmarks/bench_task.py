"""Train until a task is learned, and evaluate the policies in stock robosuite."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console

from manip.agents.policy import load_policy
from manip.benchmarks.peers import import_peer
from manip.benchmarks.time_to_success import TimedRun, held_in_stock
from manip.errors import UserError
from manip.training.run_logs import read_metrics

WARM_UP = ("--steps", "1", "--eval-episodes", "1")
"""Options of a run that compiles all code and learns nothing."""


def manip_runs(task: str, seeds: int, episodes: int) -> Iterator[TimedRun]:
    """Run `manip train` with the recipe of SAC, in a new process for each seed.

    The time is that of the whole process, with a warm cache of compiled code.
    """
    console = Console(stderr=True)
    with tempfile.TemporaryDirectory() as scratch:
        console.rule("compiling")
        _train(task, 0, Path(scratch) / "warm", WARM_UP)
        for seed in range(seeds):
            console.rule(f"manip, seed {seed} ({seed + 1} of {seeds})")
            yield _timed_run(task, seed, Path(scratch) / str(seed), episodes)


def _timed_run(task: str, seed: int, folder: Path, episodes: int) -> TimedRun:
    start = time.monotonic()
    _train(task, seed, folder)
    seconds = time.monotonic() - start
    policy = load_policy(folder)
    rate = held_in_stock(task, policy, episodes, policy.card.robot_config)
    steps = int(read_metrics(folder / "metrics.csv")[-1]["env_steps"])
    return TimedRun("manip SAC", seed, seconds, steps, rate)


def _train(task: str, seed: int, folder: Path, more: Sequence[str] = ()) -> None:
    program = (sys.executable, "-m", "manip.programs.main", "train", "--task", task)
    command = (*program, "--seed", str(seed), "--out", str(folder), *more)
    code = subprocess.run(command, check=False).returncode
    if code:
        raise UserError(f"training {task} with seed {seed} failed (exit code {code})")


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
