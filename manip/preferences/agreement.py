"""Agreement: how often pairs that were answered twice got the same answer."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

from manip.evaluation.statistics import Rate, wilson_rate
from manip.preferences.comparison_record import Comparison


@dataclass(frozen=True)
class Repeats:
    """Pairs of clips that were answered again.

    Attributes:
        same: answers that repeat the first one: the same clip is better, on either
            side, or both are equal.
        total: answers that could repeat one.
    """

    same: int
    total: int

    @property
    def rate(self) -> Rate | None:
        """The share of the same, with its Wilson 95 % interval; None without any."""
        return wilson_rate(self.same, self.total) if self.total else None


@dataclass(frozen=True)
class Agreement:
    """Repeats within each labeller, and between every two labellers.

    Attributes:
        within: of a labeller's answers, those after the first to a pair, compared with
            the one before.
        between: of every two labellers that answered a pair, their last answers.
        by_labeller: labeller -> the part of `within` that is theirs.
    """

    within: Repeats
    between: Repeats
    by_labeller: dict[str, Repeats]


def agreement(answers: Sequence[Comparison]) -> Agreement:
    """Compare the answers to the same pairs of clips; "skip" is no answer.

    Args:
        answers: valid ones, in order (see `effective`).
    """
    given: dict[frozenset[str], dict[str, list[str]]] = defaultdict(dict)
    for answer in answers:
        if answer.answer != "skip":
            given[answer.pair].setdefault(answer.labeller, []).append(answer.better)
    within: dict[str, list[bool]] = defaultdict(list)
    between: list[bool] = []
    for of_labeller in given.values():
        for name, choices in of_labeller.items():
            within[name] += _repeated(choices)
        last = [choices[-1] for choices in of_labeller.values()]
        between += [first == second for first, second in combinations(last, 2)]
    by_labeller = {name: _repeats(same) for name, same in sorted(within.items())}
    everyone = [same for repeats in within.values() for same in repeats]
    return Agreement(_repeats(everyone), _repeats(between), by_labeller)


def _repeated(choices: Sequence[str]) -> list[bool]:
    """Whether each choice but the first is that of the answer before."""
    return [a == b for a, b in pairwise(choices)]


def _repeats(same: Iterable[bool]) -> Repeats:
    flags = list(same)
    return Repeats(sum(flags), len(flags))
