"""Check where results are going to be written, before the work that makes them."""

import os
import stat
import tempfile
from collections.abc import Collection
from pathlib import Path

from manip.errors import UserError, one_line, unknown

PLOT_FORMATS = (".png", ".pdf", ".svg")
"""Endings of the files that a plot can be written to."""


def check_output(path: Path, option: str, suffixes: Collection[str] = ()) -> None:
    """Raise `UserError` unless a file can be written at `path`.

    Args:
        path: the file; folders on the way to it may be missing.
        option: the option that names it, for the message.
        suffixes: the formats that are supported; any, unless given.
    """
    if suffixes and path.suffix not in suffixes:
        reason = unknown("file format", path.suffix, suffixes)
        raise UserError(f"{option} {path!s:.80}: {reason}")
    mode = _mode(path, option)
    if mode is None or stat.S_ISREG(mode):
        _check_folder_of(path, option)
    elif stat.S_ISDIR(mode):
        raise UserError(f"{option} {path} is a folder: name a file")
    elif not os.access(path, os.W_OK):
        raise UserError(f"{option} {path} cannot be written: no permission")


def check_output_folder(path: Path, option: str) -> None:
    """Raise `UserError` unless files can be written into the folder `path`."""
    mode = _mode(path, option)
    if mode is not None and not stat.S_ISDIR(mode):
        raise UserError(f"{option} {path} is not a folder")
    _check_folder_of(path / "file", option)


def _mode(path: Path, option: str) -> int | None:
    """File type of what is at the path, links followed; None if nothing is."""
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:  # ValueError: a null byte
        raise UserError(
            f"{option} {path!s:.80} is no path: {one_line(error)}"
        ) from None


def _check_folder_of(path: Path, option: str) -> None:
    """Check the nearest folder that exists: missing ones are made there."""
    folder = next(f for f in path.absolute().parents if _mode(f, option) is not None)
    if not folder.is_dir():
        raise UserError(f"{option} {path}: {folder} is not a folder (Not a directory)")
    try:  # os.access grants root everything, on read-only disks and in /proc, too
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        reason = f"{folder} is not writable ({error.strerror})"
        raise UserError(f"{option} {path}: {reason}") from None
