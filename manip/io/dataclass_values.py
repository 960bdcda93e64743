"""Dataclasses from the plain values of a file, checked against their annotations."""

import sys
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Any,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from manip.errors import UserError, shown, unknown

Built = TypeVar("Built")

LARGEST = sys.float_info.max
"""Numbers beyond, and NaN, are refused."""


def build(cls: type[Built], values: Any) -> Built:
    """Build a dataclass from plain values; lists become tuples where it holds tuples.

    Raises:
        UserError: a name is unknown or missing, or a value has another type.
    """
    if not isinstance(values, Mapping):
        raise UserError(
            f"options of {cls.__name__} must be a mapping, not {shown(values)}"
        )
    hints = get_type_hints(cls)
    for name, value in values.items():
        if name not in hints:
            raise unknown(f"{cls.__name__} option", name, hints)
        if not _fits(value, hints[name]):
            expected = _describe(hints[name])
            raise UserError(f"{name} must be {expected}, not {shown(value)}")
    _check_complete(cls, values)
    return cls(**{n: _with_tuples(value, hints[n]) for n, value in values.items()})


def _check_complete(cls: type, values: Mapping[str, Any]) -> None:
    for field in fields(cls):
        unset = field.default is MISSING and field.default_factory is MISSING
        if unset and field.name not in values:
            raise UserError(f"{cls.__name__} needs {field.name}")


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value has the type of an annotation, down to its items."""
    parts = get_args(hint)
    match get_origin(hint) or hint:
        case kind if kind is Literal:
            return value in parts
        case kind if kind in (UnionType, Union):
            return any(_fits(value, part) for part in parts)
        case kind if kind in (tuple, list):
            many = isinstance(value, list | tuple)
            return many and all(_fits(item, parts[0]) for item in value)
        case kind if kind is dict:
            return isinstance(value, dict) and all(
                _fits(k, parts[0]) and _fits(v, parts[1]) for k, v in value.items()
            )
        case kind if kind in (int, float):
            number = isinstance(value, int | kind) and not isinstance(value, bool)
            return number and abs(value) <= LARGEST
        case kind:
            return isinstance(value, kind)


def _with_tuples(value: Any, hint: Any) -> Any:
    kinds = get_args(hint) if get_origin(hint) in (UnionType, Union) else (hint,)
    tuples = any(get_origin(kind) is tuple for kind in kinds)
    return tuple(value) if tuples and isinstance(value, list) else value


_NAMES = {int: "a whole number", float: "a number", str: "text", NoneType: "nothing"}
_NAMES |= {bool: "true or false", Path: "a path"}


def _describe(hint: Any) -> str:
    """An annotation in words."""
    parts = get_args(hint)
    match get_origin(hint) or hint:
        case kind if kind is Literal:
            return f"one of {', '.join(map(repr, parts))}"
        case kind if kind in (UnionType, Union):
            return " or ".join(map(_describe, parts))
        case kind if kind in (tuple, list):
            return f"a list, each {_describe(parts[0])}"
        case kind if kind is dict:
            return f"a mapping, each {_describe(parts[1])}"
        case kind:
            return _NAMES.get(kind, kind.__name__)
