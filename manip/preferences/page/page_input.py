"""Read and check what the page sends."""

import math
from typing import Any, cast

from flask import request

from manip.errors import UserError, shown, unknown
from manip.preferences.clips import ID
from manip.preferences.comparison_record import ANSWERS, LONGEST_NAME, Answer

LONGEST = 600.0
"""Largest time [s] of an answer that is stored: people leave pages open."""


def check_name(name: object) -> str:
    """A labeller's name without spaces around it.

    Raises:
        UserError: it is empty, too long, or has characters that cannot be printed.
    """
    text = name.strip() if isinstance(name, str) else ""
    if not 1 <= len(text) <= LONGEST_NAME or not text.isprintable():
        raise UserError(
            f"a labeller's name has 1 to {LONGEST_NAME} printable characters, "
            f"not {shown(name)}"
        )
    return text


def check_clip(clip: object) -> str:
    """A clip's id.

    Raises:
        UserError: it is none; it could be a path that leaves the folder.
    """
    if not isinstance(clip, str) or not ID.fullmatch(clip):
        raise UserError(f"{shown(clip)} is no id of a clip")
    return clip


def sent_name() -> str:
    """The labeller's name in a request."""
    return check_name(_body().get("labeller"))


def sent_pair() -> tuple[str, str]:
    """The clips of an answer, left and right."""
    body = _body()
    return check_clip(body.get("left")), check_clip(body.get("right"))


def sent_answer() -> Answer:
    """The answer itself."""
    answer = _body().get("answer")
    if answer not in ANSWERS:
        raise unknown("answer", answer, ANSWERS)
    return cast(Answer, answer)


def sent_seconds() -> float:
    """The time [s] that an answer took, at most `LONGEST`."""
    seconds: Any = _body().get("seconds")
    if not _is_number(seconds) or not 0 <= seconds < math.inf:
        raise UserError(f"expected the seconds of an answer, not {shown(seconds)}")
    return float(min(seconds, LONGEST))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _body() -> dict[str, Any]:
    """The JSON object of a request; another content type is refused by Flask."""
    body = request.get_json()
    if not isinstance(body, dict):
        raise UserError("expected a JSON object")
    return body
