"""Which pair a labeller compares next, and random pairs for the queue."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest

from manip.errors import UserError
from manip.preferences.clips import FOLDER
from manip.preferences.comparison_record import Comparison
from manip.preferences.page.drawn_pairs import fill_queue
from manip.preferences.page.pair_choice import APART, choose_pair
from manip.preferences.pair_queue import Pair, read_pairs

QUEUE = [Pair(n // 10, f"a{n}", f"b{n}") for n in range(40)]
EVERY = 5


def answered(pair: Pair, labeller: str = "Ana") -> Comparison:
    return Comparison(
        *("", "", "", labeller, pair.left, pair.right, "left", 1.0, pair.round)
    )


def label(
    people: Sequence[str], every: int = EVERY
) -> tuple[list[Pair], list[Comparison]]:
    """People in turn answer what they are shown, until all pairs are answered."""
    shown: list[Pair] = []
    valid: list[Comparison] = []
    while True:
        name = people[len(shown) % len(people)]
        pair = choose_pair(QUEUE, valid, name, (), every)
        if pair is None:
            return shown, valid
        shown.append(pair)
        valid.append(answered(pair, name))


def test_without_repeats_the_queue_is_shown_in_order() -> None:
    assert label(["Ana"], every=0)[0] == QUEUE


@pytest.mark.parametrize("people", [["Ana"], ["Ana", "Bo"]])
def test_a_share_of_the_pairs_is_repeated_once_with_sides_swapped(people) -> None:
    shown, valid = label(people)
    places = {pair: place for place, pair in enumerate(shown)}
    again = [pair for pair in shown if pair not in QUEUE]
    assert [pair for pair in shown if pair in QUEUE] == QUEUE
    assert len(again) >= len(shown) // EVERY - len(people) > 5  # none at the start
    assert set(Counter(pair.clips for pair in shown).values()) == {1, 2}
    for pair in again:
        first = Pair(pair.round, pair.right, pair.left)
        between = valid[places[first] : places[pair]]
        name = valid[places[pair]].labeller
        if between[0].labeller == name:
            assert sum(each.labeller == name for each in between) > APART


def test_several_people_repeat_pairs_of_each_other() -> None:
    _, valid = label(["Ana", "Bo"])
    people: dict[frozenset[str], set[str]] = {}
    for each in valid:
        people.setdefault(each.pair, set()).add(each.labeller)
    assert sum(len(names) == 2 for names in people.values()) >= 2


def test_pairs_on_other_screens_are_shown_last() -> None:
    taken = QUEUE[:2]
    assert choose_pair(QUEUE, [], "Ana", taken, 0) == QUEUE[2]
    rest = [answered(pair) for pair in QUEUE[2:]]
    assert choose_pair(QUEUE, rest, "Ana", taken, 0) == QUEUE[0]


def clips(folder: Path, count: int) -> Path:
    (folder / FOLDER).mkdir()
    for number in range(count):
        (folder / FOLDER / f"{number:024x}.safetensors").touch()
    return folder


def test_random_pairs_fill_the_queue(tmp_path: Path) -> None:
    clips(tmp_path, 7)
    fill_queue(tmp_path, 3, seed=0)
    first = read_pairs(tmp_path)
    assert len(set().union(*(pair.clips for pair in first))) == 6
    fill_queue(tmp_path, 3, seed=0)
    assert read_pairs(tmp_path) == first
    fill_queue(tmp_path, 21, seed=1)
    pairs = read_pairs(tmp_path)
    assert pairs[:3] == first
    assert len({pair.clips for pair in pairs}) == len(pairs) == 21


def test_too_few_clips_for_the_pairs(tmp_path: Path) -> None:
    clips(tmp_path, 3)
    with pytest.raises(UserError, match="3 clips, which make 3 pairs, and 4"):
        fill_queue(tmp_path, 4, seed=0)
    with pytest.raises(UserError, match="0 clips"):
        fill_queue(tmp_path / "none", 1, seed=0)
