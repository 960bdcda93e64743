"""WorkerPool: simulations of another library, shared out over processes."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import Any

import numpy as np

from manip.sim.external.external_sim import ExternalSim

Make = Callable[[int], ExternalSim]
"""Builds the simulation of an env_id, in the process that steps it."""


class WorkerPool:
    """N simulations in worker processes; with one process, in this very process.

    Args:
        make: builds a simulation; it can be pickled.
        num_envs: N.
        processes: 1 to N.
    """

    def __init__(self, make: Make, num_envs: int, processes: int) -> None:
        self._local: dict[int, ExternalSim] = {}
        self._workers: dict[int, ProcessPoolExecutor] = {}
        if processes == 1:
            self._local = {env_id: make(env_id) for env_id in range(num_envs)}
            return
        context = multiprocessing.get_context("spawn")
        for share in np.array_split(np.arange(num_envs), processes):
            env_ids = share.tolist()
            worker = ProcessPoolExecutor(1, context, _open_worker, (make, env_ids))
            self._workers |= dict.fromkeys(env_ids, worker)

    def call(
        self, method: str, arguments: Mapping[int, tuple[Any, ...]]
    ) -> dict[int, Any]:
        """Call a method of some simulations; the processes work at the same time.

        Args:
            method: name of a method of `ExternalSim`.
            arguments: env_id -> arguments.

        Returns:
            env_id -> result.

        Raises:
            ChildProcessError: a worker process has died.
        """
        if self._local:
            return {
                i: getattr(self._local[i], method)(*a) for i, a in arguments.items()
            }
        futures = {
            env_id: self._workers[env_id].submit(_call, env_id, method, given)
            for env_id, given in arguments.items()
        }
        try:
            return {env_id: future.result() for env_id, future in futures.items()}
        except BrokenProcessPool as error:
            raise ChildProcessError(
                "a worker process has died: is there too little memory?"
            ) from error


def end_with_parent() -> None:
    """End this worker process when its parent ends, even by SIGKILL.

    A thread waits for the end of the pipe that the parent holds open. (Linux's
    PR_SET_PDEATHSIG would end the worker with the *thread* that started it, too.)
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        watch = threading.Thread(
            target=_end_after, args=(parent.sentinel,), daemon=True
        )
        watch.start()


def _end_after(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


_simulations: dict[int, ExternalSim] = {}
"""env_id -> simulation of this worker process."""


def _open_worker(make: Make, env_ids: Sequence[int]) -> None:
    """Build this worker's simulations; Ctrl-C is handled by the parent."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _simulations.update({env_id: make(env_id) for env_id in env_ids})


def _call(env_id: int, method: str, given: tuple[Any, ...]) -> Any:
    return getattr(_simulations[env_id], method)(*given)
