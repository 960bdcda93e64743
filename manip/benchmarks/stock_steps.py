"""Rounds of steps in stock robosuite: in this process, or in several at once."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np

from manip.envs.task_registry import load_task
from manip.sim.robosuite_factory import make_stock

STEPS = 50
"""Control steps per round and process."""


def stock_steps(env: Any) -> Callable[[], int]:
    """Make a function that resets a stock environment and takes random actions."""
    rng = np.random.default_rng(0)

    def run() -> int:
        env.reset()
        for _ in range(STEPS):
            env.step(rng.uniform(-1, 1, env.action_dim))
        return STEPS

    return run


def stock_processes(task: str, count: int) -> Callable[[], int]:
    """Make the same for `count` worker processes, with one environment each."""
    context = get_context("spawn")
    name = load_task(task).robosuite_name
    workers = [
        ProcessPoolExecutor(1, context, initializer=_make_env, initargs=(name,))
        for _ in range(count)
    ]

    def run() -> int:
        futures = [worker.submit(_run_in_worker) for worker in workers]
        return sum(future.result() for future in futures)

    return run


_in_worker: dict[str, Callable[[], int]] = {}


def _make_env(name: str) -> None:
    _in_worker["run"] = stock_steps(make_stock(name, seed=0))


def _run_in_worker() -> int:
    return _in_worker["run"]()
