"""TaskBatch of another library, each at home in one of several processes."""

import multiprocessing
import signal
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import numpy as np

from manip.sim.external.external_sim import ExternalSim

Make = Callable[[int], ExternalSim]
"""Builds the world of a number, in the process where it is at home."""


class WorkerPool:
    """N worlds shared out over processes; a single one is this very process.

    Args:
        make: builds a world; it can be pickled.
        num_envs: N.
        processes: 1 to N.
    """

    def __init__(self, make: Make, num_envs: int, processes: int) -> None:
        self._here: dict[int, ExternalSim] = {}
        self._home: dict[int, ProcessPoolExecutor] = {}
        if processes == 1:
            self._here = {world: make(world) for world in range(num_envs)}
            return
        context = multiprocessing.get_context("spawn")
        for share in np.array_split(np.arange(num_envs), processes):
            worlds = share.tolist()
            home = ProcessPoolExecutor(1, context, _settle, (make, worlds))
            self._home |= dict.fromkeys(worlds, home)

    def ask(
        self, method: str, arguments: Mapping[int, tuple[Any, ...]]
    ) -> dict[int, Any]:
        """World -> what its `method` returns; the processes work at the same time.

        Raises:
            ChildProcessError: one of them has died.
        """
        if self._here:
            return {w: getattr(self._here[w], method)(*a) for w, a in arguments.items()}
        asked = {
            world: self._home[world].submit(_answer, world, method, given)
            for world, given in arguments.items()
        }
        try:
            return {world: answer.result() for world, answer in asked.items()}
        except BrokenProcessPool as error:
            raise ChildProcessError(
                "a process that steps worlds has died: is there too little memory?"
            ) from error


_settled: dict[int, ExternalSim] = {}


def _settle(make: Make, worlds: Sequence[int]) -> None:
    """Build the worlds of this process; Ctrl-C is for the one that asks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _settled.update({world: make(world) for world in worlds})


def _answer(world: int, method: str, given: tuple[Any, ...]) -> Any:
    return getattr(_settled[world], method)(*given)
