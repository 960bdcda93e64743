"""Threads that simulate, each with separate memory."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from manip.sim.scene import Scene
from manip.sim.thread_data import ThreadData, thread_data


class ThreadTeam:
    """Run native code on several threads, the calling one included.

    Args:
        scene: what they simulate.
        threads: their number.
    """

    def __init__(self, scene: Scene, threads: int) -> None:
        self._memories = [thread_data(scene) for _ in range(threads)]
        self._start_threads()

    def run(self, work: Callable[[ThreadData], None], tasks: int) -> None:
        """Call `work` with the memory of each thread, on no more threads than tasks."""
        if os.getpid() != self._process:  # threads do not survive a fork
            self._start_threads()
        first, *rest = self._memories[: max(1, tasks)]
        others = [self._pool.submit(work, memory) for memory in rest]
        work(first)
        for other in others:
            other.result()

    def _start_threads(self) -> None:
        self._process = os.getpid()
        self._pool = ThreadPoolExecutor(max(1, len(self._memories) - 1), "manip-sim")
