"""Tasks by name: entry points, `package.module:Task`, or `library/name`."""

import importlib
import sys
from collections.abc import Callable
from functools import partial
from importlib.metadata import entry_points
from importlib.util import find_spec
from inspect import get_annotations
from pathlib import Path

from manip.envs.backends.external_batch import load_external
from manip.envs.task import Task
from manip.errors import UserError, one_line, unknown

GROUP = "manip.tasks"
"""Entry-point group under which a package offers its tasks."""


def task_names() -> list[str]:
    """Names of all tasks that installed packages offer."""
    return sorted({point.name for point in entry_points(group=GROUP)})


def load_task(name: str) -> Task:
    """The task called `name`, the class at `package.module:Class`, or a library's.

    Modules of the working directory are found as well as installed ones.

    Raises:
        UserError: no such task; the message lists those that exist.
    """
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name in found:
        return _checked(name, _import(name, found[name].load))
    if ":" in name:
        return _checked(name, _import(name, partial(_find, name)))
    if "/" in name:
        return load_external(name)
    raise unknown("task", name, found)


def check_origin(name: str, folder: Path) -> None:
    """Refuse to import a task that a file names from the run folder around that file.

    Raises:
        UserError: what `module:Class` names is code that came along with the file.
    """
    whole = folder.resolve()
    run = whole.parent if (whole.parent / "config.yaml").is_file() else whole
    for place in _places(name.partition(":")[0].split(".")[0]) if ":" in name else ():
        if Path(place).resolve().is_relative_to(run):
            raise UserError(
                f"task {name!r} would run {place}, which came along with {folder}: if "
                "you trust it, move it out of there"
            )


def _places(module: str) -> list[str]:
    """Where a module would be imported from, without importing it."""
    _look_here()
    try:
        spec = find_spec(module)
    except ValueError:
        return []
    inside = spec and spec.submodule_search_locations
    return [place for place in (spec and spec.origin, *(inside or ())) if place]


def _look_here() -> None:
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))  # as `python -m` does


def _find(path: str) -> object:
    module, _, attribute = path.partition(":")
    _look_here()
    return getattr(importlib.import_module(module), attribute)


def _import(name: str, load: Callable[[], object]) -> object:
    try:
        return load()
    except Exception as error:  # a module may raise anything
        told = f"{type(error).__name__}: {one_line(error)}"
        raise UserError(f"cannot import task {name!r}: {told}") from error


def _checked(name: str, cls: object) -> Task:
    if not (isinstance(cls, type) and issubclass(cls, Task)):
        raise UserError(
            f"task {name!r} must be a subclass of manip.envs.Task, not {cls!r}"
        )
    missing = sorted(cls.__abstractmethods__)
    missing += [said for said in get_annotations(Task) if not hasattr(cls, said)]
    if missing:
        raise UserError(f"task {name!r} does not define {', '.join(missing)}")
    return cls()
