"""Check what a task's functions return, once, when its environments are built.

A mistake in a user's task becomes one line that names the task and the part, instead of
an error somewhere in the training loop.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.reward_range import ROUNDING
from manip.envs.task import Measures, Start, Task, Waypoint
from manip.errors import UserError, at_least, unknown
from manip.rewards.compose import check_weight
from manip.sim.scene import Scene

Array = np.ndarray


def check_task(task: Task, read: Measures, num_envs: int) -> None:
    """Call every function of the task, with every reward set.

    Raises:
        UserError: a part has the wrong name, shape or dtype, or a weight is not a
            finite number, or the shaped weights sum to more than 1.
    """
    at_least(1, f"{_of(task)} horizon", task.horizon)
    m = _call_named(task, "measure()", read, task.measure)
    _check_observation(task, _call_named(task, "observe()", m, task.observe), num_envs)
    for reward in task.weights:
        _check_weights(task, reward)
        _check_rewards(task, reward, m, num_envs)
    for where, method in (("success()", task.success), ("failure()", task.failure)):
        _check_flags(f"{_of(task)} {where}", _call(task, where, m, method), num_envs)
    check_memory(
        task, _call_named(task, "update_memory()", m, task.update_memory), num_envs
    )
    milestones = _call_named(task, "milestones()", m, task.milestones)
    _check_names(
        f"{_of(task)} milestones()", milestones, "milestone_names", task.milestone_names
    )
    for name, flags in milestones.items():
        _check_flags(f"{_of(task)} milestones() {name!r}", flags, num_envs)


def check_start(task: Task, scene: Scene) -> None:
    """Draw the start states of two episodes.

    Raises:
        UserError: a start state or a model field has the wrong name or shape.
    """
    episodes, where = np.arange(2), f"{_of(task)} sample_start()"
    start = task.sample_start(scene, EpisodeStreams(0, episodes, episodes))
    _check_starts(where, start, scene, 2)


def check_waypoint_names(task: Task) -> None:
    """Check that a task has waypoints, each called as one of its milestones.

    Raises:
        UserError: there are none, or one is no milestone or the last, the success.
    """
    if not task.waypoint_names:
        raise UserError(
            f"task {task.name!r} has no waypoints: define waypoint_names and "
            "sample_waypoint (docs/waypoints.md), or leave --waypoint-fraction out"
        )
    for name in task.waypoint_names:
        if name not in task.milestone_names[:-1]:
            raise UserError(
                f"{_of(task)} {unknown('waypoint', name, task.milestone_names[:-1])}"
            )


def check_waypoint(task: Task, scene: Scene, waypoint: Any, number: int) -> None:
    """Check what `sample_waypoint` returned for a number of episodes.

    Raises:
        UserError: a part has the wrong name, type or shape, or is not finite.
    """
    where = f"{_of(task)} sample_waypoint()"
    if not isinstance(waypoint, Waypoint):
        kind = type(waypoint).__name__
        raise UserError(f"{where} returns {kind}, not Waypoint(start, ...)")
    _check_starts(where, waypoint.start, scene, number)
    _check_start(f"{where} tool_pos", waypoint.tool_pos, (number, 3))
    _check_start(f"{where} tool_mat", waypoint.tool_mat, (number, 9))


def _check_starts(where: str, start: Any, scene: Scene, number: int) -> None:
    if not isinstance(start, Start):
        kind = type(start).__name__
        raise UserError(f"{where} returns {kind}, not Start(qpos, fields)")
    _check_start(f"{where} qpos", start.qpos, (number, scene.physics.nq))
    sizes = {slot.name: slot.size for slot in scene.layout.fields}
    for name, values in start.fields.items():
        if name not in sizes:
            raise UserError(f"{where}: {unknown('field', name, sizes)}")
        _check_start(f"{where} field {name!r}", values, (number, sizes[name]))


def _of(task: Task) -> str:
    return f"task {task.name!r}:"


def _call(
    task: Task, where: str, m: Measures, method: Callable[..., Any], *more: str
) -> Any:
    """The method's result; a measure that does not exist is named in the error."""
    try:
        return method(m, *more)
    except KeyError as error:
        name = error.args[0]
        if name in m:
            raise
        raise UserError(
            f"{_of(task)} {where}: {unknown('measure', name, m)}"
        ) from error


def _call_named(
    task: Task, where: str, m: Measures, method: Callable[..., Any], *more: str
) -> Mapping[str, Any]:
    result = _call(task, where, m, method, *more)
    if not isinstance(result, Mapping):
        kind = type(result).__name__
        raise UserError(f"{_of(task)} {where} returns {kind}, not named arrays")
    return result


def _check_observation(task: Task, parts: Mapping[str, Any], num_envs: int) -> None:
    where = f"{_of(task)} observe()"
    for name, part in parts.items():
        _check_part(f"{where} part {name!r}", part, num_envs)
    if not any(np.size(part) for part in parts.values()):
        raise UserError(f"{where} returns no numbers, so a policy cannot act on it")


def _check_weights(task: Task, reward: str) -> None:
    """Weights are numbers; those of "shaped" keep the reward of a step below 1."""
    weights = task.weights[reward]
    for name, weight in weights.items():
        check_weight(f"{_of(task)} weights[{reward!r}] {name!r}", weight)
    if reward == "shaped" and sum(weights.values()) > 1 + ROUNDING:
        raise UserError(
            f"{_of(task)} weights['shaped'] sum to {sum(weights.values()):g}: they "
            "must sum to at most 1, so that a step pays from 0 to 1"
        )


def _check_rewards(task: Task, reward: str, m: Measures, num_envs: int) -> None:
    where = f"reward_terms(m, {reward!r})"
    terms = _call_named(task, where, m, task.reward_terms, reward)
    _check_names(
        f"{_of(task)} {where}", terms, f"weights[{reward!r}]", task.weights[reward]
    )
    for name, term in terms.items():
        _check_numbers(f"{_of(task)} {where} term {name!r}", term, (num_envs,))


def check_memory(task: Task, memory: Mapping[str, Any], num_envs: int) -> None:
    """Compare what `update_memory` returns with `sensors.memory`, name -> k.

    Raises:
        UserError: names or shapes [N, k] differ.
    """
    where, sizes = f"{_of(task)} update_memory()", task.sensors.memory
    _check_names(where, memory, "sensors.memory", sizes)
    for name, values in memory.items():
        _check_numbers(f"{where} {name!r}", values, (num_envs, sizes[name]))


def check_visible_measures(task: Task, m: Measures, num_envs: int) -> tuple[str, ...]:
    """Call `visible_measures`; return the names in order.

    Raises:
        UserError: a value is not numbers [N], or a name is not a plain one.
    """
    where = "visible_measures()"
    named = _call_named(task, where, m, task.visible_measures)
    for name, values in named.items():
        if not str(name).isidentifier():
            raise UserError(
                f"{_of(task)} {where} name {name!r} must consist of letters, digits "
                "and _"
            )
        _check_numbers(f"{_of(task)} {where} {name!r}", values, (num_envs,))
    return tuple(named)


def _check_names(
    where: str, given: Mapping[str, Any], kind: str, expected: Iterable[str]
) -> None:
    expected = list(expected)
    if set(given) != set(expected):
        raise UserError(
            f"{where} returns {_list(given)}, but {kind} has {_list(expected)}"
        )


def _list(names: Iterable[str]) -> str:
    return ", ".join(map(repr, names)) or "nothing"


def _check_part(where: str, part: Any, num_envs: int) -> None:
    shape = np.shape(part)
    if len(shape) != 2 or shape[0] != num_envs:
        raise UserError(
            f"{where} has shape {shape}, not ({num_envs}, k): a row per environment"
        )
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


def _check_flags(where: str, flags: Any, num_envs: int) -> None:
    _check_shape(where, flags, (num_envs,))
    _check_kind(where, flags, np.bool_, "bool")


def _check_shape(where: str, values: Any, expected: tuple[int, ...]) -> None:
    if np.shape(values) != expected:
        raise UserError(f"{where} has shape {np.shape(values)}, not {expected}")


def _check_kind(where: str, values: Any, kind: type, words: str) -> None:
    dtype = getattr(values, "dtype", None)
    if not isinstance(values, np.ndarray) or not np.issubdtype(values.dtype, kind):
        raise UserError(f"{where} holds {dtype or type(values).__name__}, not {words}")
