"""Tasks by name: entry points, `package.module:Class`, or `library/name`."""

from inspect import get_annotations
from pathlib import Path

from manip.envs.external_task import load_external
from manip.envs.task import Task
from manip.errors import UserError, one_line, shown
from manip.plugins import check_origin, load_class, plugin_names

GROUP = "manip.tasks"
"""Entry-point group under which a package offers its tasks."""


def task_names() -> list[str]:
    """Names of all tasks that installed packages offer."""
    return plugin_names(GROUP)


def load_task(name: str) -> Task:
    """Build the task called `name`.

    Args:
        name: of an entry point, `package.module:Class`, or `library/name`. Modules
            are searched in the working directory and among installed packages.

    Raises:
        UserError: no such task; the message lists those that exist.
    """
    if ":" not in name and name.endswith(".py"):
        raise UserError(
            f"task {shown(name)} is a file: name its class as module:Class, from the "
            "folder that holds the module"
        )
    if ":" not in name and "/" in name:
        return load_external(name)
    return _instance(name, load_class(name, GROUP, "task"))


def load_task_named_by(folder: Path, name: str) -> Task:
    """The task that a file names: a policy card, a run's configuration, or a dump.

    Code that came along with the file is never imported; in a working directory that
    came along with it, only installed tasks are searched.

    Args:
        folder: the run folder, or the folder that holds the file.
        name: as in `load_task`.

    Raises:
        UserError: no such task, or its code lies in the folder or in its run.
    """
    check_origin(name, GROUP, "task", folder)
    return load_task(name)


def _instance(name: str, cls: type) -> Task:
    if not issubclass(cls, Task):
        raise UserError(
            f"task {name!r} must be a subclass of manip.envs.Task, not {cls!r}"
        )
    missing = sorted(cls.__abstractmethods__)
    missing += [each for each in get_annotations(Task) if not hasattr(cls, each)]
    if missing:
        raise UserError(f"task {name!r} does not define {', '.join(missing)}")
    try:
        return cls()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a constructor may raise anything, SystemExit too
        reason = f"{type(error).__name__}: {one_line(error)}"
        raise UserError(f"cannot build task {name!r}: {reason}") from error
