"""Choose which pair a labeller compares next: an open one, or an earlier one again."""

from collections import Counter
from collections.abc import Collection, Sequence
from random import Random

from manip.preferences.comparison_record import Comparison
from manip.preferences.pair_queue import Pair

APART = 5
"""A pair is not repeated among as many answers of a labeller."""


def open_pairs(queue: Sequence[Pair], valid: Sequence[Comparison]) -> list[Pair]:
    """The pairs of the queue that have no answer, in the queue's order."""
    answered = {answer.pair for answer in valid}
    return [pair for pair in queue if pair.clips not in answered]


def choose_pair(
    queue: Sequence[Pair],
    valid: Sequence[Comparison],
    labeller: str,
    taken: Collection[Pair],
    every: int,
) -> Pair | None:
    """The pair that a labeller compares next; None when all are answered.

    The choice depends on the arguments only: a server that starts again shows the same
    pair.

    Args:
        queue: all pairs to compare.
        valid: the answers that were not undone.
        labeller: name of the labeller.
        taken: pairs on the screens of others. They are shown only when no others are
            left: their labeller may have gone.
        every: each pair of this number is a repeated one; 0 for none.
    """
    unanswered = open_pairs(queue, valid)
    if not unanswered:
        return None
    own = sum(answer.labeller == labeller for answer in valid)
    if every and own % every == every - 1:
        candidates = _repeatable(valid, labeller)
        if candidates:
            return _swapped(Random(f"{labeller} {own}").choice(candidates))
    free = [pair for pair in unanswered if pair not in taken]
    return (free or unanswered)[0]


def _repeatable(valid: Sequence[Comparison], labeller: str) -> list[Comparison]:
    """Answers, of anyone, whose pair was shown once, and not to the labeller lately."""
    times = Counter(answer.pair for answer in valid)
    own = [answer.pair for answer in valid if answer.labeller == labeller]
    once = [answer for answer in valid if times[answer.pair] == 1]
    recent = own[-APART:]
    return [a for a in once if a.pair not in recent and a.answer != "skip"]


def _swapped(answer: Comparison) -> Pair:
    return Pair(left=answer.right, right=answer.left, round=answer.round)
