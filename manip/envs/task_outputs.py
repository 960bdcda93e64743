"""Evaluate a task's functions on its measures, and detect when their form changes."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from manip.envs.task import Measures, Task
from manip.errors import UserError

Array = np.ndarray


class TaskOutputs(NamedTuple):
    """What a task's functions return for N environments."""

    parts: Mapping[str, Array]
    terms: Mapping[str, Array]
    success: Array
    failure: Array
    milestones: Mapping[str, Array]


def evaluate(task: Task, m: Measures, reward: str) -> TaskOutputs:
    """Call each function of the task once."""
    return TaskOutputs(
        task.observe(m),
        task.reward_terms(m, reward),
        task.success(m),
        task.failure(m),
        task.milestones(m),
    )


Form = dict[str, tuple[Any, Any]]
"""Name -> shape and dtype."""


class OutputForm:
    """Names, shapes and dtypes of a task's outputs, which must not change in a run.

    The order of observation parts must not change either: they are joined to a vector.

    Raises:
        UserError: see `check`.
    """

    def __init__(self, task: Task, outputs: TaskOutputs) -> None:
        self._task = task
        self._forms = _forms(outputs)
        self._order = list(outputs.parts)

    def check(self, outputs: TaskOutputs) -> None:
        """Compare the outputs with those of the first call.

        Raises:
            UserError: a name, shape, dtype or the order of the parts has changed.
        """
        forms = _forms(outputs)
        if forms != self._forms:
            for where, expected in self._forms.items():
                self._compare(where, expected, forms[where])
        if list(outputs.parts) != self._order:
            raise UserError(
                f"task {self._task.name!r}: observe() gave its parts in the order "
                f"{', '.join(self._order)} at first, and now "
                f"{', '.join(outputs.parts)}"
            )

    def _compare(self, where: str, expected: Form, given: Form) -> None:
        for name in {**expected, **given}:
            if expected.get(name) != given.get(name):
                raise UserError(
                    f"task {self._task.name!r}: {where} {name!r} was "
                    f"{_words(expected.get(name))} at first, and is "
                    f"now {_words(given.get(name))}"
                )


def _forms(outputs: TaskOutputs) -> dict[str, Form]:
    flags = {"success()": outputs.success, "failure()": outputs.failure}
    return {
        "observe() part": _form(outputs.parts),
        "reward term": _form(outputs.terms),
        "result of": _form(flags),
        "milestone": _form(outputs.milestones),
    }


def _form(named: Mapping[str, Array]) -> Form:
    return {
        name: (getattr(values, "shape", None), getattr(values, "dtype", None))
        for name, values in named.items()
    }


def _words(form: tuple[Any, Any] | None) -> str:
    if form is None:
        return "missing"
    shape, dtype = form
    return "no array" if shape is None else f"{dtype} {list(shape)}"
