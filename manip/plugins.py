"""Classes that are named by text: entry points, or `package.module:Class`.

A name from the command line may lead anywhere that Python imports from, the working
directory included. A name from a file must not lead to code that came along with the
file: `check_origin` refuses it without importing anything.
"""

import importlib
import os
import sys
from functools import cache
from importlib.metadata import EntryPoint, distributions
from pathlib import Path

from manip.errors import UserError, one_line, unknown
from manip.untrusted_code import (
    import_places,
    is_inside,
    is_untrusted,
    untrusted_folders,
)

_untrusted: set[Path] = set()
"""Folders of the files that have named a class in this process."""

_added: set[str] = set()
"""Entries of sys.path that this module has added: nothing is installed there."""


def plugin_names(group: str) -> list[str]:
    """Sorted names of the entry points that installed packages offer in a group."""
    return sorted(_entry_points(group))


def load_class(name: str, group: str, kind: str) -> type:
    """Import the class of the entry point `name`, or at `package.module:Class`.

    Modules are searched in the working directory and among installed ones, unless it
    lies in a folder that `check_origin` was called with.

    Args:
        name: of an entry point, or package.module:Class.
        group: entry-point group, such as "manip.tasks".
        kind: what the class is, for error messages: "algorithm", "task".

    Raises:
        UserError: no such entry point, its import fails, or it is no class.
    """
    where = _target(name, group)
    if where is None:
        raise unknown(kind, name, plugin_names(group))
    _search_here()
    try:
        cls = _import(where)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a module may raise anything, SystemExit too
        reason = f"{type(error).__name__}: {one_line(error)}"
        raise UserError(f"cannot import {kind} {name!r}: {reason}") from error
    if not isinstance(cls, type):
        raise UserError(f"{kind} {name!r} must be a class, not {cls!r}")
    return cls


def check_origin(name: str, group: str, kind: str, folder: Path) -> None:
    """Refuse a name, read from a file in `folder`, that leads to code in that folder.

    Nothing is imported. From then on, this process and its workers find no modules in
    the folder, nor in the run folder around it.

    Raises:
        UserError: a module on the way to the class came along with the file.
    """
    _distrust(untrusted_folders(folder))
    where = _target(name, group)
    if where is None:
        return
    _search_here()
    for place in import_places(where.partition(":")[0]):
        if is_untrusted(place, _untrusted):
            raise UserError(
                f"{kind} {name!r} would run {place}, which came along with {folder}: "
                "if you trust this code, move it to the working directory or install it"
            )


def _distrust(folders: set[Path]) -> None:
    """Find no modules in some folders, in this process and in those that it starts."""
    _untrusted.update(folders)
    sys.path[:] = [entry for entry in sys.path if not is_untrusted(entry, folders)]
    if is_inside("", folders):
        # Worker processes start as `python -c`, which searches the working directory.
        os.environ["PYTHONSAFEPATH"] = "1"


def _target(name: str, group: str) -> str | None:
    """package.module:Class of a name, if there is any."""
    point = _entry_points(group).get(name)
    return point.value if point else name if ":" in name else None


def _entry_points(group: str) -> dict[str, EntryPoint]:
    """Entry points of what is installed; the first on sys.path counts."""
    return _read_entry_points(group, tuple(e for e in sys.path if e not in _added))


@cache
def _read_entry_points(group: str, path: tuple[str, ...]) -> dict[str, EntryPoint]:
    points: dict[str, EntryPoint] = {}
    for distribution in distributions(path=list(path)):
        for point in distribution.entry_points.select(group=group):
            points.setdefault(point.name, point)
    return points


def _search_here() -> None:
    """Make modules of the working directory importable, as `python -m` does."""
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path and not is_inside("", _untrusted):
        sys.path.append(here)
        _added.add(here)


def _import(where: str) -> object:
    module, _, attribute = where.partition(":")
    return getattr(importlib.import_module(module), attribute)
