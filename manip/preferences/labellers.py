"""Simulated labellers: the six of B-Pref (Lee et al. 2021, arXiv 2111.03026).

They see which of two clips is better by a criterion r, a number for each control step,
and answer imperfectly (section 4 there, Algorithm 1):

    P(left) = sigmoid(beta (sum_t gamma^(T-1-t) r_t(left) - the same of right))

with a mistake in a fraction epsilon of the answers; "skip" where both sums are small,
and "equal" where they differ little. B-Pref's limits follow the current policy's mean
return; here they are constants per step, so that an answer depends on two clips only.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from manip.errors import check_choice
from manip.preferences.clips import Clip
from manip.preferences.comparison_record import Answer
from manip.preferences.tastes import Taste

Array = np.ndarray

Kind = Literal["oracle", "mistake", "noisy", "skip", "myopic", "equal"]
"""oracle: always right; mistake: wrong in a fraction of the answers; noisy: the less
sure, the smaller the difference; skip: does not compare two bad clips; myopic: looks
at the end of the clips; equal: calls similar clips equal."""

KINDS: tuple[Kind, ...] = get_args(Kind)

Criterion = Callable[[Clip], Array]
"""Returns the value [T] of each step of a clip."""

LIMIT = 0.05
"""Limit of "skip" and "equal" [criterion per step]: a tenth, as in B-Pref, of half of
the most that a step of a task pays."""


@dataclass(frozen=True)
class TasteCriterion:
    """The task's reward minus the weighted penalties of a taste, if there is one."""

    taste: Taste | None = None

    def __call__(self, clip: Clip) -> Array:
        """[T] float64: the value of each step."""
        if self.taste is None:
            return clip.reward
        penalties = self.taste.penalties(clip.measures, clip.header.measure_names)
        return clip.reward - self.taste.weight * penalties


@dataclass(frozen=True)
class SimulatedLabeller:
    """Compare clips by a criterion, with the flaws of B-Pref's teachers.

    An answer is a function of the seed and the two clips: repeated, it is the same.

    Attributes:
        criterion: the value [T] of each step of a clip.
        seed: of its mistakes and its noise.
        rationality: beta; None for infinite: always the better one.
        discount: gamma, the weight of a step relative to the step after it.
        mistakes: epsilon, the fraction of answers that are turned round.
        skip_below: value per step; with less in both clips the answer is "skip".
        equal_within: difference per step; with less the answer is "equal".
    """

    criterion: Criterion
    seed: int = 0
    rationality: float | None = None
    discount: float = 1.0
    mistakes: float = 0.0
    skip_below: float = -np.inf
    equal_within: float = 0.0

    def __call__(self, left: Clip, right: Clip) -> Answer:
        """Which clip is better."""
        values = self.criterion(left), self.criterion(right)
        means = [value.mean() for value in values]
        if max(means) < self.skip_below:
            return "skip"
        sums = [self._discounted(value) for value in values]
        if abs(means[0] - means[1]) < self.equal_within or sums[0] == sums[1]:
            return "equal"
        better = self._choose(sums[0] - sums[1], self._random(left, right))
        return "left" if better else "right"

    def _discounted(self, value: Array) -> float:
        weights = self.discount ** np.arange(len(value))[::-1]
        return float((weights * value).sum())

    def _choose(self, difference: float, rng: np.random.Generator) -> bool:
        """Whether the left clip is called better; `difference` is left minus right."""
        drawn, mistaken = rng.random(2)
        better = difference > 0
        if self.rationality is not None:
            better = bool(drawn < _sigmoid(self.rationality * difference))
        return better != bool(mistaken < self.mistakes)

    def _random(self, left: Clip, right: Clip) -> np.random.Generator:
        return np.random.default_rng([self.seed, int(left.id, 16), int(right.id, 16)])


def make_labeller(
    kind: Kind, criterion: Criterion, seed: int = 0, mistakes: float = 0.1
) -> SimulatedLabeller:
    """One of B-Pref's six simulated labellers.

    Args:
        kind: see `Kind`.
        criterion: the value [T] of each step of a clip.
        seed: of its random numbers.
        mistakes: fraction of wrong answers of "mistake".

    Raises:
        UserError: there is no such kind.
    """
    check_choice("labeller", kind, KINDS)
    flaws: dict[str, dict[str, float]] = {
        "oracle": {},
        "mistake": {"mistakes": mistakes},
        "noisy": {"rationality": 1.0},
        "skip": {"skip_below": LIMIT},
        "myopic": {"discount": 0.9},
        "equal": {"equal_within": LIMIT},
    }
    return SimulatedLabeller(criterion, seed, **flaws[kind])


def _sigmoid(x: float) -> float:
    return float(1 / (1 + np.exp(-np.clip(x, -700, 700))))
