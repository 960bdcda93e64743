"""Reward weights from a run's options: `lift=0.6 reach=0.1`."""

from collections.abc import Mapping, Sequence
from math import isfinite

from manip.envs.task_batch import TaskBatch
from manip.errors import UserError, check_choice, shown


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


def effective_weights(batch: TaskBatch, items: Sequence[str]) -> Mapping[str, float]:
    """Weight of each term that a batch pays, in the order of its terms.

    Raises:
        UserError: an item names no term of the batch's reward set.
    """
    weights, overrides = batch.task.weights[batch.reward_set], parse_weights(items)
    for name in overrides:
        check_choice("reward term", name, weights)
    return {name: {**weights, **overrides}[name] for name in batch.reward_names}


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if isfinite(number) else None
