"""Print without failing: a closed pipe or terminal does not end a program."""

import contextlib
import errno
import io
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console

from manip.io.printable import printable

Failure = Callable[[], OSError | None]

READER_LEFT = (errno.EPIPE, errno.EIO, errno.EBADF)
"""Errors of a write when the pipe's reader ended, the terminal or the file closed."""

PIPE_WIDTH = 200
"""Columns of a table that is not printed on a terminal."""


def console() -> Console:
    """A console on stdout; in a pipe or file it is wide enough for every table."""
    shown = Console()
    if not shown.is_terminal:
        shown.width = max(shown.width, PIPE_WIDTH)
    return shown


def print_path(path: Path) -> None:
    """Print the path of a file that was written, on one line."""
    console().print(printable(str(path)), markup=False, highlight=False, soft_wrap=True)


@contextlib.contextmanager
def lasting_output() -> Iterator[Failure]:
    """Have writes to sys.stdout and sys.stderr never raise inside the context.

    A character that the terminal's encoding lacks is printed as "?". What cannot be
    written is dropped. Yields a function that returns why stdout could not be written,
    or None; a reader that left (`| head -1`) is no failure.
    """
    _occupy_closed_descriptors()
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = map(_lasting, before)

    def failure() -> OSError | None:
        sys.stdout.flush()
        raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
        lost = raw.lost if isinstance(raw, _LastingFile) else None
        return None if lost and lost.errno in READER_LEFT else lost

    try:
        yield failure
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        sys.stdout, sys.stderr = before


class _LastingFile(io.FileIO):
    """A file that drops what cannot be written, and stores the first error."""

    lost: OSError | None = None

    def write(self, data: Any, /) -> int:
        if self.lost is None:
            try:
                return super().write(data) or len(data)
            except OSError as error:
                self.lost = error
        return len(data)


def _lasting(stream: TextIO | None) -> TextIO:
    """The stream's file under a new stream; streams without a file are not changed."""
    if stream is None:  # its descriptor was closed when Python started
        return open(os.devnull, "w")
    try:
        descriptor = stream.fileno()
        stream.flush()
    except (OSError, ValueError):  # io.UnsupportedOperation is both
        return stream
    return io.TextIOWrapper(
        io.BufferedWriter(_LastingFile(descriptor, "w", closefd=False)),
        encoding=stream.encoding,
        errors="replace",
        line_buffering=True,
    )


def _occupy_closed_descriptors() -> None:
    """Open descriptors 0 to 2 where closed, for child processes, too. Otherwise a file
    that is saved gets one of them, and with it what libraries print.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)
