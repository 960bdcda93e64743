"""Read and check what the page sends."""

import math
from typing import Any, cast

from flask import request

from manip.errors import UserError, shown, unknown
from manip.preferences.clips import check_clip_id
from manip.preferences.comparison_record import ANSWERS, Answer, check_labeller

LONGEST = 600.0
"""Largest time [s] of an answer that is stored: people leave pages open."""


def check_name(name: object) -> str:
    """A labeller's name without spaces around it.

    Raises:
        UserError: it is empty, too long, or has characters that cannot be printed.
    """
    return check_labeller(name.strip() if isinstance(name, str) else "")


def sent_name() -> str:
    """The labeller's name in a request."""
    return check_name(_body().get("labeller"))


def sent_pair() -> tuple[str, str]:
    """The clips of an answer, left and right."""
    body = _body()
    return check_clip_id(body.get("left")), check_clip_id(body.get("right"))


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
