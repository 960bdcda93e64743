"""Errors that say what was asked, what exists, and what to do."""

import reprlib
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from numbers import Integral

MOST = 10**10
"""Nothing is counted beyond: no machine has memory or time for it."""


class UserError(ValueError):
    """A mistake in what was asked; programs print it as one line and exit with 2."""


class DamagedError(UserError):
    """A file that is not what was once written."""


def at_least(least: int, name: str, value: object) -> None:
    """Raise `UserError` unless the value is a whole number from `least` to `MOST`."""
    if not isinstance(value, Integral) or int(value) < least:
        raise UserError(f"{name} must be at least {least}, not {shown(value)}")
    if int(value) > MOST:
        raise UserError(f"{name} must be at most {MOST}, not {shown(value)}")


_brief = reprlib.Repr()
_brief.maxstring = _brief.maxother = 200


def shown(value: object) -> str:
    """A value in a few words on one line, however much it holds."""
    try:
        return " ".join(_brief.repr(value).split())
    except ValueError:  # thousands of digits
        return "a number too large to show"


def one_line(error: BaseException) -> str:
    """The start of an error's message, without line breaks."""
    return " ".join(str(error).split())[:200]


def unknown(kind: str, asked: object, known: Iterable[str]) -> UserError:
    """Build the error for a name that does not exist, with the nearest one that does.

    `unknown("task", "Lfit", ["Lift", "Reach"])` reads
    "unknown task 'Lfit': did you mean 'Lift'? known tasks: Lift, Reach".
    """
    names = {name.casefold(): name for name in known}
    close = get_close_matches(shown(asked).strip("'").casefold(), names, n=1)
    hint = f"did you mean {names[close[0]]!r}? " if close else ""
    listing = ", ".join(names.values())
    kinds = f"{kind[:-1]}ies" if kind.endswith("y") else f"{kind}s"
    return UserError(f"unknown {kind} {shown(asked)}: {hint}known {kinds}: {listing}")


def check_choice(kind: str, asked: str, known: Collection[str]) -> None:
    """Raise `UserError` unless `asked` is one of the `known` names."""
    if asked not in known:
        raise unknown(kind, asked, sorted(known))


def out_of_memory(error: BaseException) -> bool:
    """Whether an error says that memory ran out, in the words of any allocator."""
    words = ("allocate memory", "out of memory", "bad_alloc", "start new thread")
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and any(word in str(error) for word in words)
    )
