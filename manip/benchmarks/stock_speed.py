"""Stock robosuite as a contestant: in this process, and in one process a core."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np

from manip.envs.task_registry import load_task
from manip.sim.robosuite_factory import make_stock

STEPS = 50
"""Control steps a round and process."""


def stock_steps(env: Any) -> Callable[[], int]:
    """A function that resets a stock environment and acts at random in it."""
    rng = np.random.default_rng(0)

    def go() -> int:
        env.reset()
        for _ in range(STEPS):
            env.step(rng.uniform(-1, 1, env.action_dim))
        return STEPS

    return go


def stock_processes(task: str, count: int) -> Callable[[], int]:
    """The same in `count` worker processes at once, each with an environment."""
    context = get_context("spawn")
    name = load_task(task).robosuite_name
    workers = [
        ProcessPoolExecutor(1, context, initializer=_begin, initargs=(name,))
        for _ in range(count)
    ]

    def go() -> int:
        return sum(done.result() for done in [w.submit(_work) for w in workers])

    return go


_worker: dict[str, Callable[[], int]] = {}


def _begin(name: str) -> None:
    _worker["go"] = stock_steps(make_stock(name, seed=0))


def _work() -> int:
    return _worker["go"]()
