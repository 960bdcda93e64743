"""A separate thread for OpenGL.

OpenGL has one current context per thread. Drawing in a separate thread never
changes the context that another library made current in the user's thread.
"""

import os
import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

Result = TypeVar("Result")


class GLThread:
    """Run functions one by one in a thread that ends with the main thread.

    It ends before `atexit` functions run, among them those of mujoco and robosuite
    that shut OpenGL down: after that, contexts can no longer be freed.

    Args:
        at_end: called in the thread as its last function.
    """

    def __init__(self, at_end: Callable[[], None]) -> None:
        self._process = os.getpid()
        self._jobs: SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None]
        self._jobs = SimpleQueue()
        self._at_end = at_end
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

    def _work(self) -> None:
        while job := self._jobs.get():
            future, function = job
            try:
                future.set_result(function())
            except BaseException as error:
                future.set_exception(error)
            del job, future, function  # results hold OpenGL objects
        self._at_end()

    def _end_with_main(self) -> None:
        threading.main_thread().join()
        self._jobs.put(None)


class Closable(Protocol):
    """An object that holds an OpenGL context."""

    def close(self) -> None:
        """Free the context; does nothing the second time."""


_thread: GLThread | None = None
_open: set[Closable] = set()


def gl_thread() -> GLThread:
    """The process's only OpenGL thread; started by the first call."""
    global _thread
    if _thread is None or not _thread.alive:
        _open.clear()  # after a fork: they are the parent's
        _thread = GLThread(at_end=_close_all)
    return _thread


def open_in_gl_thread(make: Callable[[], Closable]) -> Any:
    """Build an object in the OpenGL thread, and close it when the process ends."""
    opened = gl_thread().call(make)
    _open.add(opened)
    return opened


def close_later(opened: Closable) -> None:
    """Close an object in the OpenGL thread, without waiting: for finalizers."""
    if opened in _open and _thread is not None and _thread.alive:
        _open.discard(opened)
        _thread.post(opened.close)


def _close_all() -> None:
    while _open:
        _open.pop().close()
