"""Formulas of a task's observation: each part from named measurements, as text.

They are found by calling the task's own functions once with `Traced` arrays, and
compared with what these functions return for other numbers. A part that needs more than
`manip.deploy.formulas` offers, or what a robot cannot measure, has none.
"""

import ast
from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.deploy.formulas import LONGEST, evaluate, parse_formula
from manip.envs.task import Measures, Task
from manip.envs.traced import Traced

Array = np.ndarray

ROWS = 97
"""Environments of the trace: no array of a task has another axis of this length."""

CHECKED = 5
"""Of them, those whose formulas are evaluated and compared."""

CONSTANT = (
    *("gripper_speed", "gripper_narrowest", "gripper_widest"),
    *("rest_pos", "joint_low", "joint_high"),
)
"""Readings that never change: their numbers become part of the formulas."""


def observation_formulas(task: Task, read: Measures) -> dict[str, str]:
    """Part -> its formula, for the parts that have one.

    Args:
        task: the task.
        read: readings [N, ...] of any state.
    """
    numbers = _varied(read, task)
    traced = {
        name: value if name in CONSTANT else Traced(value, name)
        for name, value in numbers.items()
    }
    with np.errstate(all="ignore"):
        measured = task.measure(numbers)
        parts, expected = _traced_parts(task, traced, measured), task.observe(measured)
        return {
            name: _plain(part.text)
            for name, part in parts.items()
            if isinstance(part, Traced) and _agrees(part.text, numbers, expected[name])
        }


def _traced_parts(
    task: Task, traced: Mapping[str, Any], measured: Measures
) -> Mapping[str, Any]:
    """The parts of `observe`; those of readings alone if `measure` cannot be traced."""
    for measure in (task.measure, lambda read: {**measured, **read}):
        try:
            return task.observe(measure(traced))
        except (TypeError, ValueError, AttributeError, IndexError):
            continue  # it branches on a measurement, or calls what cannot be traced
    return {}


def needed_measurements(formulas: Mapping[str, str]) -> list[str]:
    """Names of the measurements that formulas read, in alphabetical order."""
    trees = [parse_formula(text) for text in formulas.values()]
    called = {id(n.func) for t in trees for n in ast.walk(t) if isinstance(n, ast.Call)}
    return sorted(
        {
            node.id
            for tree in trees
            for node in ast.walk(tree)
            if isinstance(node, ast.Name) and id(node) not in called
        }
    )


def _varied(read: Measures, task: Task) -> dict[str, Array]:
    """Readings of `ROWS` environments: the first one's, with noise of unit size.

    Flags are 0 or 1 at random. What holds for all environments stays.
    """
    rng = np.random.default_rng(0)
    flags = {*task.sensors.touches}
    varied = {}
    for name, values in read.items():
        row = np.asarray(values)[:1]
        shape = (ROWS, *row.shape[1:])
        if name in CONSTANT:
            varied[name] = row
        elif name in flags:
            varied[name] = rng.integers(0, 2, shape).astype(float)
        else:
            varied[name] = row + 0.3 * rng.standard_normal(shape)
    return varied


def _agrees(text: str, numbers: Mapping[str, Array], expected: Array) -> bool:
    """Whether a formula gives what the task does, for some environments."""
    if not text or len(text) > LONGEST:
        return False
    try:
        tree = parse_formula(text)
        for row in range(CHECKED):
            values = {name: v[row] for name, v in numbers.items() if len(v) == ROWS}
            result = np.ravel(np.float32(evaluate(tree, values)))
            if not np.allclose(result, np.float32(expected[row]), 1e-6, 1e-6):
                return False
    except ValueError:
        return False
    return True


def _plain(text: str) -> str:
    """The formula without brackets around all of it."""
    return ast.unparse(parse_formula(text))
