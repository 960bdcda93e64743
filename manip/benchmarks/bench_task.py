"""How long a task takes to learn, judged in stock robosuite."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console

from manip.agents.policy import load_policy
from manip.benchmarks.attempts import Attempt, held_in_stock
from manip.benchmarks.peers import peer
from manip.errors import UserError
from manip.training.run_logs import read_metrics

WARM_UP = ("--steps", "1", "--eval-episodes", "1")
"""Options of a run that compiles everything and learns nothing."""


def ours(task: str, seeds: int, episodes: int) -> Iterator[Attempt]:
    """`manip train` with the recipe of SAC, in a fresh process for each seed.

    The time is that of the whole process, with compiled code in the cache.
    """
    console = Console(stderr=True)
    with tempfile.TemporaryDirectory() as scratch:
        console.rule("compiling what is not compiled yet")
        _train(task, 0, Path(scratch) / "warm", WARM_UP)
        for seed in range(seeds):
            console.rule(f"manip, seed {seed} ({seed + 1} of {seeds})")
            yield _attempt(task, seed, Path(scratch) / str(seed), episodes)


def _attempt(task: str, seed: int, folder: Path, episodes: int) -> Attempt:
    began = time.monotonic()
    _train(task, seed, folder)
    seconds = time.monotonic() - began
    policy = load_policy(folder)
    robot = policy.card.robot_config
    held = held_in_stock(task, policy, episodes, robot)
    steps = int(read_metrics(folder / "metrics.csv")[-1]["env_steps"])
    return Attempt("manip SAC", seed, seconds, steps, held)


def _train(task: str, seed: int, folder: Path, more: Sequence[str] = ()) -> None:
    program = (sys.executable, "-m", "manip.programs.main", "train", "--task", task)
    run = (*program, "--seed", str(seed), "--out", str(folder), *more)
    code = subprocess.run(run, check=False).returncode
    if code:
        raise UserError(f"training {task} with seed {seed} failed (exit code {code})")


def peers(task: str, seeds: int, cap: float, episodes: int) -> Iterator[Attempt]:
    """Stable-Baselines3's SAC on stock robosuite, for `cap` seconds at most.

    Its time runs from the making of its environment to the first evaluation that
    reaches the goal, or to the cap.
    """
    learn = peer("task_sb3").learn
    console = Console(stderr=True)
    for seed in range(seeds):
        console.rule(f"Stable-Baselines3, seed {seed}, at most {cap / 60:g} min")
        yield learn(task, seed, cap, episodes)
