"""Reward weights from a run's options: `lift=0.6 reach=0.1`."""

from collections.abc import Sequence
from math import isfinite

from manip.errors import UserError, shown


def parse_weights(items: Sequence[str]) -> dict[str, float]:
    """Term -> weight of items `term=weight`.

    Raises:
        UserError: an item has another form, or a term stands there twice.
    """
    weights: dict[str, float] = {}
    for item in items:
        name, equals, number = item.partition("=")
        if not equals or not name or _number(number) is None:
            raise UserError(
                f"reward weight {shown(item)} must be a name and a number, as in "
                "lift=0.6"
            )
        if name in weights:
            raise UserError(f"reward weight {name!r} is given twice")
        weights[name] = float(number)
    return weights


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if isfinite(number) else None
