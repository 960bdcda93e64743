"""Errors that name what was wrong, what was expected and what exists."""

import reprlib
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from numbers import Integral

MOST = 10**10
"""Largest count of anything: no machine has memory or time for more."""


class UserError(ValueError):
    """A mistake of the user; programs print it as one line and exit with code 2."""


class DamagedError(UserError):
    """A file that was changed since it was written, or is of another kind."""


def at_least(least: int, name: str, value: object) -> None:
    """Raise `UserError` unless the value is a whole number from `least` to `MOST`."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not whole or int(value) < least:  # type: ignore[call-overload]
        raise UserError(f"{name} must be at least {least}, not {shown(value)}")
    if int(value) > MOST:  # type: ignore[call-overload]
        raise UserError(f"{name} must be at most {MOST}, not {shown(value)}")


ENDINGS_IN_IES = ("gy", "ry", "ty")
"""Of kinds whose plural ends in "ies": memory, quality."""

_brief = reprlib.Repr()
_brief.maxstring = _brief.maxother = 200


def shown(value: object) -> str:
    """A value on one line, shortened where it is long."""
    try:
        return " ".join(_brief.repr(value).split())
    except ValueError:  # thousands of digits
        return "a number too large to show"


def one_line(error: BaseException) -> str:
    """The start of an error's message, without line breaks."""
    return " ".join(str(error).split())[:200]


def unknown(kind: str, name: object, known: Iterable[str]) -> UserError:
    """Build the error for a name that does not exist, with the nearest one that does.

    `unknown("task", "Lfit", ["Lift", "Reach"])` reads
    "unknown task 'Lfit': did you mean 'Lift'? known tasks: Lift, Reach".
    """
    names = {item.casefold(): item for item in known}
    close = get_close_matches(shown(name).strip("'").casefold(), names, n=1)
    hint = f"did you mean {names[close[0]]!r}? " if close else ""
    listing = ", ".join(names.values())
    kinds = f"{kind[:-1]}ies" if kind.endswith(ENDINGS_IN_IES) else f"{kind}s"
    return UserError(f"unknown {kind} {shown(name)}: {hint}known {kinds}: {listing}")


def check_choice(kind: str, name: str, known: Collection[str]) -> None:
    """Raise `UserError` unless `name` is one of the `known` names."""
    if name not in known:
        raise unknown(kind, name, sorted(known))


ALLOCATOR_MESSAGES = (
    *("allocate memory", "can't allocate", "not enough memory", "out of memory"),
    *("bad_alloc", "bad alloc", "start new thread"),
)
"""In the errors of allocators that raise no MemoryError (torch, C++, threads)."""


def out_of_memory(error: BaseException) -> bool:
    """Whether an error of any type comes from an allocator."""
    message = str(error).lower()
    return isinstance(error, MemoryError) or any(
        part in message for part in ALLOCATOR_MESSAGES
    )
