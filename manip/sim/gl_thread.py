"""Separate threads for OpenGL.

OpenGL has one current context per thread. Drawing in a separate thread never
changes the context that another library made current in the user's thread.
"""

import gc
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, Generic, Protocol, TypeVar

Result = TypeVar("Result")


class Closable(Protocol):
    """An object that holds an OpenGL context."""

    def close(self) -> None:
        """Free the context; does nothing the second time."""


Opened = TypeVar("Opened", bound=Closable)


class GLThread:
    """Run functions one by one in a thread that ends with the main thread.

    It ends before `atexit` functions run, among them those of mujoco and robosuite
    that shut OpenGL down: after that, contexts can no longer be freed.
    """

    def __init__(self) -> None:
        self._process = os.getpid()
        self._jobs: SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None]
        self._jobs = SimpleQueue()
        self._open: set[Closable] = set()
        self._worker = threading.Thread(target=self._work, name="manip-gl")
        self._worker.start()
        threading.Thread(target=self._end_with_main, name="manip-gl-end").start()

    @property
    def alive(self) -> bool:
        """Whether it runs: not after a fork, nor once the main thread has ended."""
        return self._process == os.getpid() and self._worker.is_alive()

    def call(self, function: Callable[[], Result]) -> Result:
        """Run a function in the thread; return or raise what it does."""
        if threading.current_thread() is self._worker:  # a finalizer, say
            return function()
        return self.post(function).result()

    def post(self, function: Callable[[], Result]) -> "Future[Result]":
        """Run a function in the thread later, after those that wait."""
        future: Future[Result] = Future()
        self._jobs.put((future, function))
        return future

    def open(self, make: Callable[[], Opened]) -> Opened:
        """Build an object in the thread, which closes it as it ends."""
        opened = self.call(make)
        self._open.add(opened)
        return opened

    def close_later(self, opened: Closable) -> None:
        """Close an object in the thread, without waiting: for finalizers."""
        if opened in self._open and self.alive:
            self._open.discard(opened)
            self.post(opened.close)

    def _work(self) -> None:
        while job := self._jobs.get():
            future, function = job
            try:
                future.set_result(function())
            except BaseException as error:
                future.set_exception(error)
            del job, future, function  # results hold OpenGL objects
        while self._open:
            self._open.pop().close()

    def _end_with_main(self) -> None:
        threading.main_thread().join()
        self._jobs.put(None)


_threads: dict[int, GLThread] = {}


def gl_thread(number: int = 0) -> GLThread:
    """One of the process's OpenGL threads; started by the first call."""
    thread = _threads.get(number)
    if thread is None or not thread.alive:
        thread = _threads[number] = GLThread()
    return thread


class InGLThread(Generic[Opened]):
    """An object that lives in an OpenGL thread, and is closed there after its owner.

    Args:
        make: builds the object; called in the thread.
        number: of the thread, as in `gl_thread`.
    """

    def __init__(self, make: Callable[[], Opened], number: int = 0) -> None:
        gc.collect()  # frees contexts of batches that lie in reference cycles
        self._thread = gl_thread(number)
        self.opened = self._thread.open(make)

    @property
    def alive(self) -> bool:
        """Whether its thread runs: not after a fork."""
        return self._thread.alive

    def call(self, function: Callable[[], Result]) -> Result:
        """Run a function in the thread; return or raise what it does."""
        return self._thread.call(function)

    def post(self, function: Callable[[], Result]) -> "Future[Result]":
        """Run a function in the thread later, after those that wait."""
        return self._thread.post(function)

    def close(self) -> None:
        """Close the object, without waiting."""
        self._thread.close_later(self.opened)

    def __del__(self) -> None:
        if "opened" in vars(self):  # it was built
            self.close()
