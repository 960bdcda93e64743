"""Files that are whole or absent."""

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

_PARTIAL = ".partial-"
"""In the name of every temporary file."""


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Have `write` fill a temporary file beside `path`, then put it in place.

    The temporary name is hidden and keeps the suffix, by which writers tell formats.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    prefix = f".{path.stem}{_PARTIAL}"
    handle, name = tempfile.mkstemp(path.suffix, prefix, path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        _flush(temporary)
        temporary.chmod(0o644)
        os.replace(temporary, path)
        _flush(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    replace_file(path, lambda temporary: temporary.write_text(text))


def link_file(source: Path, path: Path) -> None:
    """Have `path` name the file that `source` names now, or a copy of it."""
    replace_file(path, lambda temporary: _link(source, temporary))


def remove_partial(folder: Path) -> None:
    """Remove what killed writers left under temporary names, there and one level down.

    No deeper: a run folder may be one that holds much else.
    """
    for place in ("", "*/"):
        for left in folder.glob(f"{place}.*{_PARTIAL}*"):
            left.unlink()


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
