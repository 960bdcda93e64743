"""Reward terms and weights: choose the weights, and sum the weighted terms."""

from collections.abc import Mapping
from numbers import Real

import numpy as np

from manip.errors import UserError, shown, unknown

Array = np.ndarray

LARGEST_WEIGHT = 1e6
"""Largest size of a weight: float32 rewards stay far from overflow."""


def weighted_sum(terms: Mapping[str, Array], weights: Mapping[str, float]) -> Array:
    """Sum of weights[name] * terms[name], shape [N].

    Raises:
        UserError: the names differ; a term without weight would vanish silently.
    """
    if terms.keys() != weights.keys():
        raise UserError(
            f"reward terms {sorted(terms)} and weights {sorted(weights)} must have "
            "the same names"
        )
    return sum(weights[name] * terms[name] for name in weights)  # type: ignore[return-value]


def override_weights(
    weights: Mapping[str, float], overrides: Mapping[str, float]
) -> dict[str, float]:
    """The weights of a reward set, with those of some terms replaced.

    Raises:
        UserError: there is no such term, or its weight is not a finite number of at
            most `LARGEST_WEIGHT`.
    """
    if not isinstance(overrides, Mapping):
        raise UserError(
            f"reward_weights must be term=weight pairs, not {shown(overrides)}"
        )
    for name, weight in overrides.items():
        if name not in weights:
            raise unknown("reward term", name, weights)
        check_weight(f"weight of reward term {name!r}", weight)
    return {name: overrides.get(name, weight) for name, weight in weights.items()}


def check_weight(what: str, weight: object) -> None:
    """Raise `UserError` unless a weight is finite and at most `LARGEST_WEIGHT`."""
    if (
        not isinstance(weight, Real)
        or isinstance(weight, bool)
        or not abs(float(weight)) <= LARGEST_WEIGHT
    ):
        raise UserError(
            f"{what} must be a number from -{LARGEST_WEIGHT:g} to {LARGEST_WEIGHT:g}, "
            f"not {shown(weight)}"
        )
