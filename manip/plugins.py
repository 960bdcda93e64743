"""Classes that are named by text: entry points, or `package.module:Class`.

A name from the command line may lead anywhere that Python imports from, the working
directory included. A name from a file must not lead into the folder of that file:
`check_origin` refuses it without importing anything.
"""

import importlib
import sys
from collections.abc import Iterator
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from manip.errors import UserError, one_line, unknown

RUN_PARTS = ("policy", "checkpoints", "dumps")
"""Folders of a run folder: a file in one of them came along with the whole run."""


def plugin_names(group: str) -> list[str]:
    """Sorted names of the entry points that installed packages offer in a group."""
    return sorted(_entry_points(group))


def load_class(name: str, group: str, kind: str) -> type:
    """Import the class of the entry point `name`, or at `package.module:Class`.

    Args:
        group: entry-point group, such as "manip.algorithms".
        kind: what the class is, for error messages: "algorithm", "task".

    Raises:
        UserError: no such entry point, or its import fails.
    """
    where = _target(name, group)
    if where is None:
        raise unknown(kind, name, plugin_names(group))
    module, _, attribute = where.partition(":")
    _search_working_directory()
    try:
        cls = getattr(importlib.import_module(module), attribute)
    except Exception as error:  # a module may raise anything
        reason = f"{type(error).__name__}: {one_line(error)}"
        raise UserError(f"cannot import {kind} {name!r}: {reason}") from error
    if not isinstance(cls, type):
        raise UserError(f"{kind} {name!r} must be a class, not {cls!r}")
    return cls


def check_origin(name: str, group: str, kind: str, folder: Path) -> None:
    """Refuse a name, read from a file in `folder`, that leads to code in that folder.

    Nothing is imported. Where `folder` is the policy folder of a run, the whole run
    folder counts.

    Raises:
        UserError: a module on the way to the class came along with the file.
    """
    run = _run_folder(folder)
    if (where := _target(name, group)) is None:
        return
    for place in (*_metadata(name, group), *_places(where.partition(":")[0])):
        if place.is_relative_to(run):
            raise UserError(
                f"{kind} {name!r} would run {place}, which came along with {folder}: "
                "if you trust it, move it out of there"
            )


def _target(name: str, group: str) -> str | None:
    point = _entry_points(group).get(name)
    return point.value if point else name if ":" in name else None


def _entry_points(group: str) -> dict[str, EntryPoint]:
    return _read_entry_points(group, tuple(sys.path))


@cache
def _read_entry_points(group: str, _: tuple[str, ...]) -> dict[str, EntryPoint]:
    """Of two entry points with one name, the first on sys.path counts."""
    points = list(entry_points(group=group))
    return {point.name: point for point in reversed(points)}


def _run_folder(folder: Path) -> Path:
    whole = folder.resolve()
    return whole.parent if whole.name in RUN_PARTS else whole


def _metadata(name: str, group: str) -> Iterator[Path]:
    """The folder that a name's entry point was read from, if it has one."""
    point = _entry_points(group).get(name)
    if point is not None and point.dist is not None:
        yield Path(str(point.dist.locate_file(""))).resolve()


def _places(module: str) -> Iterator[Path]:
    """Files that an import of a dotted module runs, and folders that it searches.

    importlib.util.find_spec would import the packages around the module.
    """
    _search_working_directory()
    search = None
    for part in module.split("."):
        spec = _find_spec(part, search)
        if spec is None:
            return
        search = list(spec.submodule_search_locations or ())
        for place in (spec.origin, *search):
            if place:
                yield Path(place).resolve()


def _find_spec(part: str, search: list[str] | None) -> ModuleSpec | None:
    """Find a module in the given folders, or a package at the top of sys.path."""
    if not part.isidentifier():
        return None
    if search is not None:
        return PathFinder.find_spec(part, search)
    found = (finder.find_spec(part, None) for finder in sys.meta_path)
    return next((spec for spec in found if spec is not None), None)


def _search_working_directory() -> None:
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))  # as `python -m` does
