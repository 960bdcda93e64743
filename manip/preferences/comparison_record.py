"""Comparison: one answer to the question which of two clips is better."""

import hashlib
import json
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal, get_args

from manip.errors import UserError, check_choice, shown
from manip.io.dataclass_values import build
from manip.io.option_ranges import WHOLE, Range, check_options
from manip.preferences.clips import check_clip_id

Answer = Literal["left", "right", "equal", "skip"]
"""The better clip; or both are equally good; or they cannot be compared."""

ANSWERS: tuple[Answer, ...] = get_args(Answer)

LONGEST_NAME = 80
"""Characters of a labeller's name."""


@dataclass(frozen=True)
class Comparison:
    """An answer of a person or a simulated labeller, as a line of a file.

    Attributes:
        id: hash of all that follows, except `previous`.
        previous: hash of the line before; empty in the first line.
        time: when it was given, in UTC: 2026-11-30T01:02:03.456789+00:00.
        labeller: who gave it.
        left, right: ids of the clips.
        answer: see `Answer`.
        seconds: how long it took.
        round: round of labels that requested it.
        undoes: id of the answer, of the same labeller, that this line takes back; None
            if this line is an answer itself.
    """

    id: str
    previous: str
    time: str
    labeller: str
    left: str
    right: str
    answer: Answer
    seconds: Annotated[float, Range(0, 10**9)]
    round: Annotated[int, WHOLE]
    undoes: str | None = None

    @property
    def pair(self) -> frozenset[str]:
        """The two clips."""
        return frozenset((self.left, self.right))

    @property
    def better(self) -> str:
        """Id of the better clip, "equal", or "skip"."""
        return {"left": self.left, "right": self.right}.get(self.answer, self.answer)


def comparison_id(values: dict[str, Any]) -> str:
    """The id of a comparison with these values."""
    named = {k: v for k, v in sorted(values.items()) if k not in ("id", "previous")}
    return line_hash(json.dumps(named).encode())


def line_hash(line: bytes) -> str:
    """The first 24 hexadecimal digits of the SHA-256 of a line."""
    return hashlib.sha256(line).hexdigest()[:24]


def read_comparison(values: dict[str, Any]) -> Comparison:
    """Build a comparison from plain values of any origin.

    Raises:
        UserError: a value is impossible, or the id is not the hash of the others.
    """
    record = build(Comparison, values)
    check_options(record)
    check_answer(record.labeller, record.left, record.right, record.answer)
    _check_time(record.time)
    if record.id != comparison_id(values):
        raise UserError("its contents were changed: they do not have its id")
    return record


def _check_time(time: str) -> None:
    try:
        offset = datetime.fromisoformat(time).utcoffset()
    except ValueError:
        offset = None
    if offset != timedelta(0):
        raise UserError(f"time {shown(time)} is no time in UTC")


def check_labeller(name: str) -> str:
    """The name of a labeller, if it is one.

    Raises:
        UserError: it is empty or too long, has spaces around it, or characters that
            cannot be printed.
    """
    plain = name.isprintable() and name.strip() == name
    if not plain or not 1 <= len(name) <= LONGEST_NAME:
        raise UserError(
            f"a labeller's name must have 1 to {LONGEST_NAME} printable characters, "
            f"not {shown(name)}"
        )
    return name


def check_answer(labeller: str, left: str, right: str, answer: str) -> None:
    """Raise `UserError` unless these make an answer."""
    check_labeller(labeller)
    for clip in left, right:
        check_clip_id(clip)
    if left == right:
        raise UserError(f"clip {left} is compared with itself")
    check_choice("answer", answer, ANSWERS)
