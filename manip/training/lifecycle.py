"""One process at a time in a run folder, and how it is asked to leave."""

import fcntl
import os
import platform
import signal
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from manip.errors import UserError, one_line

LEAVING = b"manip: saves as soon as it can, and leaves; once more leaves at once\n"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep a run folder to this process while inside.

    The system lets go of the lock when its process dies, however it dies.

    Raises:
        UserError: another process is at work in the folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "run.lock").open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            raise UserError(
                f"{folder} is in use by {file.read() or 'another process'}: wait for "
                "it, stop it, or choose another folder with --out"
            ) from None
        except OSError as error:
            warnings.warn(f"{folder} is not locked: {one_line(error)}", stacklevel=2)
        file.truncate(0)
        file.write(f"process {os.getpid()} on {platform.node()}")
        file.flush()
        yield


class Interruptible:
    """While inside, the first Ctrl-C, SIGTERM or SIGHUP calls `stop`; a second kills.

    Signals that are ignored, as SIGHUP is by nohup, stay so.
    """

    SIGNALS: Sequence[signal.Signals] = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop = stop

    def __enter__(self) -> None:
        heard = [s for s in self.SIGNALS if signal.getsignal(s) != signal.SIG_IGN]
        self._before = {s: signal.signal(s, self._handle) for s in heard}

    def __exit__(self, *_: object) -> None:
        self._restore()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        with suppress(OSError):  # the terminal may be gone
            os.write(2, LEAVING)  # as print must not be called in a handler
        self._restore()
        self._stop()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
