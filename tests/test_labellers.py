"""Simulated labellers: B-Pref's formulas, and answers that repeat."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from clip_files import cut_all, recorded, with_measures

from manip.errors import UserError
from manip.preferences.clips import Clip
from manip.preferences.comparison_record import ANSWERS
from manip.preferences.labellers import (
    KINDS,
    LIMIT,
    SimulatedLabeller,
    TasteCriterion,
    make_labeller,
)
from manip.preferences.tastes import load_taste

MANY = 2000


@pytest.fixture(scope="module")
def clip() -> Clip:
    return cut_all(*recorded("Lift"))[0]


@pytest.fixture(scope="module")
def clips(clip: Clip) -> list[Clip]:
    """Clips that differ in their ids, and so in the random numbers of an answer."""
    return [with_measures(clip, step) for step in range(MANY + 1)]


class Values:
    """A criterion with chosen values; the other clip has 0 in each step."""

    def __init__(self, clip: Clip, values: np.ndarray) -> None:
        self.clip, self.values = clip, values

    def __call__(self, clip: Clip) -> np.ndarray:
        return self.values if clip is self.clip else 0.0 * self.values


def answers(clips: list[Clip], values: Any, kind: str, **options: Any) -> list[str]:
    """Answers to pairs of neighbours of which the left one has `values`."""
    values = np.asarray(values, float)
    labellers = (make_labeller(kind, Values(left, values), **options) for left in clips)
    return [f(a, b) for f, (a, b) in zip(labellers, pairwise(clips), strict=False)]


def share(given: list[str], answer: str) -> float:
    return sum(each == answer for each in given) / len(given)


def assert_frequency(given: list[str], answer: str, probability: float) -> None:
    """Within 4 standard deviations of the binomial distribution."""
    deviation = np.sqrt(probability * (1 - probability) / len(given))
    assert share(given, answer) == pytest.approx(probability, abs=4 * deviation + 1e-9)


def test_an_oracle_is_always_right(clips: list[Clip]) -> None:
    assert set(answers(clips[:50], [0.0, 0.001], "oracle")) == {"left"}
    assert set(answers(clips[:50], [0.0, -0.001], "oracle")) == {"right"}
    assert set(answers(clips[:50], [1.0, -1.0], "oracle")) == {"equal"}


@pytest.mark.parametrize("mistakes", [0.1, 0.2])
def test_mistakes_are_as_frequent_as_requested(
    clips: list[Clip], mistakes: float
) -> None:
    given = answers(clips, [0.5, 0.5], "mistake", mistakes=mistakes)
    assert_frequency(given, "right", mistakes)
    assert set(given) == {"left", "right"}


@pytest.mark.parametrize("values", [[0.25, 0.25], [0.0, -1.0], [2.0, 0.2]])
def test_noise_follows_bradley_and_terry(
    clips: list[Clip], values: list[float]
) -> None:
    given = answers(clips, values, "noisy")
    assert_frequency(given, "left", 1 / (1 + np.exp(-sum(values))))


def test_a_myopic_labeller_looks_at_the_end(clips: list[Clip]) -> None:
    early, late = np.array([1.0] + [0.0] * 9), np.array([0.0] * 9 + [0.5])
    assert set(answers(clips[:20], early - late, "oracle")) == {"left"}
    assert set(answers(clips[:20], early - late, "myopic")) == {"right"}
    assert 0.9**9 < 0.5  # the weight of the first of ten steps
    assert set(answers(clips[:20], early - 0.7 * late, "myopic")) == {"left"}


def test_two_bad_clips_are_skipped(clips: list[Clip]) -> None:
    pairs = clips[:20]
    assert set(answers(pairs, [LIMIT - 0.01] * 4, "skip")) == {"skip"}
    assert set(answers(pairs, [LIMIT + 0.01] * 4, "skip")) == {"left"}


def test_similar_clips_are_equal(clips: list[Clip]) -> None:
    pairs = clips[:20]
    assert set(answers(pairs, [LIMIT - 0.01] * 4, "equal")) == {"equal"}
    assert set(answers(pairs, [-LIMIT - 0.01] * 4, "equal")) == {"right"}


@pytest.mark.parametrize("kind", KINDS)
def test_an_answer_repeats(kind: Any, clips: list[Clip]) -> None:
    """It depends on the seed and the clips, not on the answers before."""
    taste = TasteCriterion(load_taste("Lift", "gentle"))
    varied = [
        with_measures(clip, n, hand_tilt=np.random.default_rng(n).uniform(0, 1))
        for n, clip in enumerate(clips[:40])
    ]
    one, again, other = (make_labeller(kind, taste, seed) for seed in (0, 0, 1))
    given = [one(a, b) for a, b in pairwise(varied)]
    assert [again(a, b) for a, b in reversed([*pairwise(varied)])] == given[::-1]
    assert set(given) <= set(ANSWERS)
    differs = [other(a, b) for a, b in pairwise(varied)] != given
    assert differs == (kind in ("mistake", "noisy"))


def test_an_unknown_labeller_is_refused() -> None:
    with pytest.raises(UserError, match="known labellers: equal, mistake, myopic"):
        make_labeller("orakle", TasteCriterion())  # type: ignore[arg-type]


def test_the_criterion_is_the_reward_minus_the_weighted_taste(clip: Clip) -> None:
    taste = load_taste("Lift", "upright")
    tilted = with_measures(clip, 1, hand_tilt=0.25)
    assert np.array_equal(TasteCriterion()(clip), clip.reward)
    np.testing.assert_allclose(
        TasteCriterion(taste)(tilted), clip.reward - 2 * 0.5, 1e-6
    )
    assert SimulatedLabeller(TasteCriterion(taste))(tilted, clip) == "right"


def test_who_did_what_does_not_matter(clip: Clip) -> None:
    """The better one is better on either side."""
    labeller = make_labeller("oracle", TasteCriterion(load_taste("Lift", "gentle")))
    fast = with_measures(clip, 1, hand_speed=0.5)
    slow = with_measures(clip, 2, hand_speed=0.1)
    assert (labeller(slow, fast), labeller(fast, slow)) == ("left", "right")
    same = replace(slow, header=replace(slow.header, actor="another"))
    assert labeller(slow, same) == "equal"
