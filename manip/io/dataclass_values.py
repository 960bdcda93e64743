"""Dataclasses from the plain values of a file, checked against their annotations."""

import sys
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from manip.errors import UserError, shown, unknown

Built = TypeVar("Built")

LARGEST = sys.float_info.max
"""What is larger, or NaN, is no number."""


def build(cls: type[Built], values: Any) -> Built:
    """The dataclass with these values; lists become tuples where it holds tuples.

    Raises:
        UserError: a name is unknown or missing, or a value is of another type.
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
            said = f"{_words(hints[name])}, not {shown(value)}"
            raise UserError(f"{name} must be {said}")
    for field in fields(cls):  # type: ignore[arg-type]
        unset = field.default is MISSING and field.default_factory is MISSING
        if unset and field.name not in values:
            raise UserError(f"{cls.__name__} needs {field.name}")
    return cls(**{name: _frozen(value, hints[name]) for name, value in values.items()})


def _fits(value: Any, hint: Any) -> bool:
    parts = get_args(hint)
    match get_origin(hint) or hint:
        case kind if kind is Literal:
            return value in parts
        case kind if kind is UnionType:
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


def _frozen(value: Any, hint: Any) -> Any:
    return tuple(value) if get_origin(hint) is tuple else value


_WORDS = {int: "a whole number", float: "a number", str: "text", NoneType: "nothing"}
_WORDS |= {bool: "true or false", Path: "a path"}


def _words(hint: Any) -> str:
    parts = get_args(hint)
    match get_origin(hint) or hint:
        case kind if kind is Literal:
            return f"one of {', '.join(map(repr, parts))}"
        case kind if kind is UnionType:
            return " or ".join(map(_words, parts))
        case kind if kind in (tuple, list):
            return f"a list, each {_words(parts[0])}"
        case kind if kind is dict:
            return f"a mapping, each {_words(parts[1])}"
        case kind:
            return _WORDS.get(kind, kind.__name__)
