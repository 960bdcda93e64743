"""What a task's functions must give, checked once, when its worlds are built.

A user's task that gives something else is told so in one line, which names the task
and the part, instead of failing somewhere in the training loop.
"""

import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task
from manip.errors import UserError, at_least, one_line, unknown
from manip.sim.scene import Scene

Array = np.ndarray


@contextmanager
def blamed(task: Task) -> Iterator[None]:
    """While inside, what a task's code raises is told in one line, with its place.

    Raises:
        UserError: instead of any other exception.
    """
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        told = f"{type(error).__name__}: {one_line(error)}"
        raise UserError(f"{_of(task)} {told} ({_place(task, error)})") from error


def _place(task: Task, error: Exception) -> str:
    """The last line of the task's own file that led to an error."""
    file = getattr(sys.modules.get(type(task).__module__), "__file__", None)
    frames = traceback.extract_tb(error.__traceback__)
    last = ([frame for frame in frames if frame.filename == file] or frames)[-1]
    return f"{Path(last.filename).name}, line {last.lineno}"


def check_task(task: Task, read: Measures, worlds: int) -> None:
    """Try all that a task says of its worlds, in every reward set.

    Raises:
        UserError: a part has the wrong name, shape or kind of numbers.
    """
    at_least(1, f"{_of(task)} horizon", task.horizon)
    m = _ask_named(task, "measure()", read, task.measure)
    _check_observation(task, _ask_named(task, "observe()", m, task.observe), worlds)
    for reward in task.weights:
        _check_rewards(task, reward, m, worlds)
    for where, method in (("success()", task.success), ("failure()", task.failure)):
        _check_flags(f"{_of(task)} {where}", _ask(task, where, m, method), worlds)
    _check_memory(
        task, _ask_named(task, "update_memory()", m, task.update_memory), worlds
    )
    reached = _ask_named(task, "milestones()", m, task.milestones)
    _check_names(
        f"{_of(task)} milestones()", reached, "milestones", task.milestone_names
    )
    for name, flags in reached.items():
        _check_flags(f"{_of(task)} milestones() stage {name!r}", flags, worlds)


def check_start(task: Task, scene: Scene) -> None:
    """Try the starts that a task draws, on two episodes.

    Raises:
        UserError: a place or a model field has the wrong name or shape.
    """
    episodes, where = np.arange(2), f"{_of(task)} sample_start()"
    start = task.sample_start(scene, EpisodeStreams(0, episodes, episodes))
    if not isinstance(start, Start):
        kind = type(start).__name__
        raise UserError(f"{where} gives {kind}, not Start(qpos, fields)")
    _check_start(f"{where} qpos", start.qpos, (2, scene.physics.nq))
    sizes = {slot.name: slot.size for slot in scene.layout.fields}
    for name, values in start.fields.items():
        if name not in sizes:
            raise UserError(f"{where}: {unknown('field', name, sizes)}")
        _check_start(f"{where} field {name!r}", values, (2, sizes[name]))


def _of(task: Task) -> str:
    return f"task {task.name!r}:"


def _ask(
    task: Task, where: str, m: Measures, method: Callable[..., Any], *more: str
) -> Any:
    """What the method gives; a measure that it looks for in vain is told."""
    try:
        return method(m, *more)
    except KeyError as error:
        name = error.args[0]
        if name in m:
            raise
        raise UserError(
            f"{_of(task)} {where}: {unknown('measure', name, m)}"
        ) from error


def _ask_named(
    task: Task, where: str, m: Measures, method: Callable[..., Any], *more: str
) -> Mapping[str, Any]:
    given = _ask(task, where, m, method, *more)
    if not isinstance(given, Mapping):
        kind = type(given).__name__
        raise UserError(f"{_of(task)} {where} gives {kind}, not named arrays")
    return given


def _check_observation(task: Task, parts: Mapping[str, Any], worlds: int) -> None:
    where = f"{_of(task)} observe()"
    for name, part in parts.items():
        _check_part(f"{where} part {name!r}", part, worlds)
    if not any(np.size(part) for part in parts.values()):
        raise UserError(f"{where} gives no numbers: nothing to act on")


def _check_rewards(task: Task, reward: str, m: Measures, worlds: int) -> None:
    where = f"reward_terms(m, {reward!r})"
    terms = _ask_named(task, where, m, task.reward_terms, reward)
    _check_names(
        f"{_of(task)} {where}", terms, f"weights[{reward!r}]", task.weights[reward]
    )
    for name, term in terms.items():
        _check_numbers(f"{_of(task)} {where} term {name!r}", term, (worlds,))


def _check_memory(task: Task, memory: Mapping[str, Any], worlds: int) -> None:
    where, sizes = f"{_of(task)} update_memory()", task.sensors.memory
    _check_names(where, memory, "sensors.memory", sizes)
    for name, values in memory.items():
        _check_numbers(f"{where} {name!r}", values, (worlds, sizes[name]))


def _check_names(
    where: str, given: Mapping[str, Any], kind: str, expected: Iterable[str]
) -> None:
    expected = list(expected)
    if set(given) != set(expected):
        raise UserError(
            f"{where} gives {_list(given)}, but {kind} names {_list(expected)}"
        )


def _list(names: Iterable[str]) -> str:
    return ", ".join(map(repr, names)) or "nothing"


def _check_part(where: str, part: Any, worlds: int) -> None:
    shape = np.shape(part)
    if len(shape) != 2 or shape[0] != worlds:
        raise UserError(f"{where} has shape {shape}, not ({worlds}, k): a row a world")
    _check_kind(where, part, np.floating, "floating-point numbers")


def _check_start(where: str, values: Any, expected: tuple[int, ...]) -> None:
    _check_numbers(where, values, expected)
    if not np.isfinite(values).all():
        raise UserError(f"{where} holds numbers that are not finite")


def _check_numbers(where: str, values: Any, expected: tuple[int, ...]) -> None:
    _check_shape(where, values, expected)
    kind = np.asarray(values).dtype
    if not np.can_cast(kind, np.float64, "same_kind"):
        raise UserError(f"{where} holds {kind}, not numbers")


def _check_flags(where: str, flags: Any, worlds: int) -> None:
    _check_shape(where, flags, (worlds,))
    _check_kind(where, flags, np.bool_, "bool")


def _check_shape(where: str, values: Any, expected: tuple[int, ...]) -> None:
    if np.shape(values) != expected:
        raise UserError(f"{where} has shape {np.shape(values)}, not {expected}")


def _check_kind(where: str, values: Any, kind: type, words: str) -> None:
    found = getattr(values, "dtype", None)
    if not isinstance(values, np.ndarray) or not np.issubdtype(values.dtype, kind):
        raise UserError(f"{where} holds {found or type(values).__name__}, not {words}")
