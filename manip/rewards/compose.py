"""Composition of a reward: terms and weights under the same names."""

from collections.abc import Mapping

import numpy as np

from manip.errors import UserError

Array = np.ndarray


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
