"""Turn errors of a task's code into one line that names the task and the place."""

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from manip.envs.task import Task
from manip.errors import UserError, one_line


@contextmanager
def blamed(task: Task) -> Iterator[None]:
    """Raise UserError instead of any other exception, with its file and line.

    A task that calls sys.exit() must not end the program; only Ctrl-C passes.
    """
    try:
        yield
    except (UserError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise UserError(
            f"task {task.name!r}: {_words(error)} ({_place(task, error)})"
        ) from error


@contextmanager
def exits_blamed(task: Task) -> Iterator[None]:
    """Raise UserError instead of SystemExit and other BaseExceptions.

    For calls of a simulation, whose own errors are not the task's.
    """
    try:
        yield
    except (Exception, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise UserError(f"task {task.name!r}: {_words(error)}") from error


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {one_line(error)}"


def _place(task: Task, error: BaseException) -> str:
    """The last line of the task's own file that led to an error."""
    file = getattr(sys.modules.get(type(task).__module__), "__file__", None)
    frames = traceback.extract_tb(error.__traceback__)
    last = ([frame for frame in frames if frame.filename == file] or frames)[-1]
    return f"{Path(last.filename).name}, line {last.lineno}"
