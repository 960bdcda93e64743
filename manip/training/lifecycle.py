"""Lock a run folder for one process, and end runs on signals after saving them."""

import fcntl
import os
import platform
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import TextIO

from manip.errors import UserError, one_line

STOPPING = b"manip: stopping after this update and saving; repeat to quit at once\n"

_NO_LINKS = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a run folder for this process while inside.

    The operating system releases the lock when the process ends, however it ends.

    Raises:
        UserError: another process trains in the folder, or the lock is a link.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "run.lock"
    handle = os.open(path, _NO_LINKS, 0o644)
    with os.fdopen(handle, "r+", encoding="utf-8", errors="replace") as file:
        if os.fstat(handle).st_nlink > 1:
            raise UserError(f"{path} is a hard link to another file: remove it")
        _lock(file, folder)
        file.seek(0)
        file.truncate()
        file.write(f"process {os.getpid()} on {platform.node()}")
        file.flush()
        yield


def in_use(folder: Path) -> bool:
    """Whether a process holds the lock of a run folder."""
    path = folder / "run.lock"
    if path.is_symlink() or not path.is_file():
        return False
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks
            return False
    return False


def _lock(file: TextIO, folder: Path) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = " ".join(file.read(200).split()) or "another process"
        raise UserError(
            f"{folder} is in use by {holder}: wait until it ends, stop it, or choose "
            "another folder with --out"
        ) from None
    except OSError as error:
        warnings.warn(f"{folder} is not locked: {one_line(error)}", stacklevel=2)


class SignalHandler:
    """Call `stop` at the first Ctrl-C, SIGTERM or SIGHUP; a second one kills.

    Signals that the process ignores, as under nohup, stay ignored. Outside the main
    thread, where Python allows no handlers, signals keep their meaning.
    """

    SIGNALS: Sequence[signal.Signals] = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop = stop
        self._previous: dict[signal.Signals, object] = {}

    def __enter__(self) -> None:
        if threading.current_thread() is threading.main_thread():
            for number in self.SIGNALS:
                # None: a handler of C code, which Python could not put back.
                if signal.getsignal(number) not in (signal.SIG_IGN, None):
                    self._previous[number] = signal.signal(number, self._handle)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._restore()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if sys.__stderr__ is not None:  # otherwise handle 2 may be any file
            with suppress(OSError):  # the terminal may be gone
                os.write(2, STOPPING)  # print must not be called in a handler
        self._restore()
        self._stop()

    def _restore(self) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
        self._previous = {}
