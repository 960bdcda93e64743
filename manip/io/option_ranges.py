"""Ranges of options, declared beside the option and checked for any dataclass.

    gamma: Annotated[float, SHARE] = 0.95
    critic_hidden: Annotated[tuple[int, ...], COUNT] = (128, 128)   # each of them
    horizon: Annotated[int | None, COUNT] = None                    # None is allowed

Numbers without a declared range must be finite.
"""

import sys
from dataclasses import dataclass, fields
from typing import Any, get_type_hints

from manip.errors import MOST, UserError


@dataclass(frozen=True)
class Range:
    """The least and the greatest value of an option; both are allowed."""

    least: float
    most: float

    def __contains__(self, value: float) -> bool:
        return bool(self.least <= value <= self.most)

    def __str__(self) -> str:
        return f"from {self.least} to {self.most}"


COUNT = Range(1, MOST)
"""A whole number of at least 1."""
WHOLE = Range(0, MOST)
"""A whole number of at least 0."""
SHARE = Range(0, 1)
"""A fraction."""
NUMBER = Range(0, 10**9)
"""Zero or more."""
POSITIVE = Range(1e-9, 10**9)
"""More than zero."""
SIGNED = Range(-(10**9), 10**9)
"""Any sensible number."""
FINITE = Range(-sys.float_info.max, sys.float_info.max)
"""Neither infinite nor NaN: what holds for numbers without a range."""


def ranges_of(options: type) -> dict[str, Range]:
    """Return the ranges that a dataclass declares: name of the option -> range."""
    hints = get_type_hints(options, include_extras=True)
    declared = {}
    for field in fields(options):
        marks = getattr(hints[field.name], "__metadata__", ())
        if ranges := [mark for mark in marks if isinstance(mark, Range)]:
            declared[field.name] = ranges[0]
    return declared


def check_options(options: Any) -> None:
    """Check every number among a dataclass's options against its range.

    Raises:
        UserError: one is out of its range.
    """
    declared = ranges_of(type(options))
    for field in fields(options):
        for value in _numbers(getattr(options, field.name)):
            _check(field.name, value, declared.get(field.name, FINITE))


def _numbers(value: Any) -> list[float]:
    items = value if isinstance(value, tuple | list) else (value,)
    return [item for item in items if isinstance(item, int | float)]


def _check(name: str, value: float, allowed: Range) -> None:
    if value in allowed:
        return
    if allowed == FINITE:
        limit = "a finite number"
    elif allowed == SHARE:
        limit = "from 0 to 1"
    elif value > allowed.most:
        limit = f"at most {allowed.most}"
    else:
        limit = f"at least {allowed.least}"
    raise UserError(f"{name} must be {limit}, not {value}")
