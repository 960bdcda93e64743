"""Atomic writes: a file is complete or absent after a crash of process or machine."""

import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path

from manip.errors import UserError

_PARTIAL = ".partial-"
"""In the name of every temporary file."""

_OPEN_FILES = (Path("/dev/fd"), Path("/proc/self/fd"))
"""Where a process finds its open files: /dev/stdout is a link to /proc/self/fd/1."""


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Have `write` fill a temporary file beside `path`, then rename it to `path`.

    The temporary name is hidden and has the same suffix, from which writers derive the
    format. A symbolic link stays: the file that it points to is replaced. A stream
    (/dev/stdout, a FIFO, a terminal) is written to directly.

    Raises:
        UserError: `path` is a folder, a disk or a socket.
    """
    if _is_stream(path):
        _write_through(path, write)
        return
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = _temporary(target)
    try:
        write(temporary)
        _flush(temporary)
        temporary.chmod(_mode(target))
        os.replace(temporary, target)
        _flush(target.parent)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, atomically."""
    replace_file(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def link_file(source: Path, path: Path) -> None:
    """Make `path` a second name of the file `source`, or a copy of it."""
    replace_file(path, lambda temporary: _link(source, temporary))


def remove_partial(folder: Path, *subfolders: str) -> None:
    """Remove temporary files of killed writers from a folder and some subfolders."""
    for place in (folder, *(folder / name for name in subfolders)):
        for path in place.glob(f".*{_PARTIAL}*"):
            if path.is_file() or path.is_symlink():
                path.unlink()


def is_partial(path: Path) -> bool:
    """Whether a file has the name of a temporary one."""
    return path.name.startswith(".") and _PARTIAL in path.name


def _is_stream(path: Path) -> bool:
    """Whether to write through: a terminal, pipe or /dev/stdout; not a regular file.

    Raises:
        UserError: the path is a folder, a disk or a socket.
    """
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    if stat.S_ISDIR(mode):
        raise UserError(f"cannot write {path}: it is a folder, not a file")
    if stat.S_ISBLK(mode) or stat.S_ISSOCK(mode):
        kind = "disk" if stat.S_ISBLK(mode) else "socket"
        raise UserError(f"cannot write {path}: it is a {kind}, not a file")
    return not stat.S_ISREG(mode) or _descriptor(path) is not None


def _descriptor(path: Path) -> int | None:
    """Number of the open file that a path names, itself or by a link, if any."""
    place = path.absolute()
    while place.parent not in _OPEN_FILES or not place.name.isdigit():
        if not place.is_symlink():
            return None
        place = Path(os.path.normpath(place.parent / place.readlink()))
    return int(place.name)


def _write_through(path: Path, write: Callable[[Path], object]) -> None:
    with tempfile.TemporaryDirectory(prefix="manip-") as folder:
        temporary = Path(folder) / f"output{path.suffix}"
        write(temporary)
        with temporary.open("rb") as source, os.fdopen(_open(path), "wb") as stream:
            shutil.copyfileobj(source, stream)


def _open(path: Path) -> int:
    """Open a stream; an open file is shared, as what follows goes to its end."""
    descriptor = _descriptor(path)
    if descriptor is None:
        return os.open(path, os.O_WRONLY)
    return os.dup(descriptor)


def _temporary(path: Path) -> Path:
    handle, name = tempfile.mkstemp(path.suffix, _prefix(path), path.parent)
    os.close(handle)
    return Path(name)


def _prefix(path: Path) -> str:
    return f".{path.stem[:40]}{_PARTIAL}"


def _mode(path: Path) -> int:
    """Permissions of a file, or those of a new one."""
    return path.stat().st_mode & 0o777 | 0o600 if path.exists() else 0o644


def _link(source: Path, temporary: Path) -> None:
    temporary.unlink()
    try:
        os.link(source, temporary)
    except OSError:  # not every file system has hard links
        shutil.copyfile(source, temporary)


def _flush(path: Path) -> None:
    """Have a file's contents, or a folder's names, reach the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
