"""A lock against use by two threads at the same time."""

import os
from threading import Lock

from manip.errors import UserError


class ExclusiveUse:
    """A `with` block that a second thread cannot enter: it raises instead of waiting.

    Waiting would hide that two threads advance the same environments. A process that
    was forked starts with the lock free.

    Args:
        name: what is used, for the error message.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._lock, self._process = Lock(), os.getpid()

    def __enter__(self) -> None:
        if os.getpid() != self._process:
            self._lock, self._process = Lock(), os.getpid()
        if not self._lock.acquire(blocking=False):
            raise UserError(
                f"{self._name} is in use by another thread: give each thread its own"
            )

    def __exit__(self, *error: object) -> None:
        self._lock.release()
