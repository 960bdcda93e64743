"""Append-only files of JSON objects, one a line, that survive a killed writer."""

import fcntl
import json
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from manip.errors import DamagedError, UserError

MOST_BYTES = 2**28
"""Largest file that is read."""


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The objects of a file in order; none if there is no such file.

    A last line without line break, which a killed writer may leave, is left out.

    Raises:
        UserError: the file is too large, or no regular file.
        DamagedError: a line is no JSON object.
    """
    return [parse_line(line, path, n) for n, line in enumerate(raw_lines(path)[0], 1)]


def raw_lines(path: Path) -> tuple[list[bytes], bool]:
    """The lines of a file, without a last one that is incomplete; whether there is one.

    Raises:
        UserError: the file is too large, or no regular file.
    """
    if not _exists(path):
        return [], False
    if path.stat().st_size > MOST_BYTES:
        raise UserError(f"{path} is larger than {MOST_BYTES} bytes")
    *lines, rest = path.read_bytes().split(b"\n")
    return lines, bool(rest)


def append_lines(path: Path, items: Iterable[Mapping[str, Any]]) -> None:
    """Append objects in one write, and wait until they are on the disk.

    What a killed writer left of a last line is cut off before. Writers of several
    processes take turns.
    """
    update_lines(path, lambda _: items)


def update_lines(
    path: Path, make: Callable[[list[bytes]], Iterable[Mapping[str, Any]]]
) -> None:
    """As `append_lines`, of objects that depend on the lines that are there before.

    Args:
        path: the file.
        make: returns the objects for these lines; no other process writes meanwhile.

    Raises:
        UserError: the path names no regular file.
    """
    _exists(path)
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    with os.fdopen(handle, "r+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        content = file.read()
        whole = content.rfind(b"\n") + 1
        items = make(content[:whole].split(b"\n")[:-1])
        text = "".join(json.dumps(item) + "\n" for item in items)
        file.truncate(whole)
        file.seek(0, os.SEEK_END)
        file.write(text.encode())
        file.flush()
        os.fsync(file.fileno())


def _exists(path: Path) -> bool:
    """Whether there is such a file; a pipe would be waited for, without end.

    Raises:
        UserError: it is a folder, a link, a pipe or a device.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise UserError(f"{path} is no regular file: remove it")
    return path.exists()


def parse_line(line: bytes, path: Path, number: int) -> dict[str, Any]:
    """The object of a line.

    Raises:
        DamagedError: the line is no JSON object.
    """
    try:
        value = json.loads(line)
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise DamagedError(f"{path} is damaged: line {number} is no JSON object")
    return value
