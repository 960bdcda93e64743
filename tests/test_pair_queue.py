"""The queue of pairs that wait for an answer."""

from pathlib import Path

import pytest

from manip.errors import DamagedError
from manip.io.json_lines import append_lines
from manip.preferences.pair_queue import QUEUE, Pair, append_pairs, read_pairs

A, B, C = (letter * 24 for letter in "abc")
PAIRS = [Pair(0, A, B, "run"), Pair(1, C, A)]


def test_pairs_are_read_as_they_were_written(tmp_path: Path) -> None:
    assert read_pairs(tmp_path) == []
    append_pairs(tmp_path / "new", PAIRS[:1])
    append_pairs(tmp_path / "new", PAIRS[1:])
    assert read_pairs(tmp_path / "new") == PAIRS


def test_what_a_killed_writer_left_is_replaced(tmp_path: Path) -> None:
    append_pairs(tmp_path, PAIRS[:1])
    with (tmp_path / QUEUE).open("a") as file:
        file.write('{"round": 1, "left": "c')
    assert read_pairs(tmp_path) == PAIRS[:1]
    append_pairs(tmp_path, PAIRS[1:])
    assert read_pairs(tmp_path) == PAIRS


@pytest.mark.parametrize(
    "change",
    [
        {"round": "0"},
        {"round": None},
        {"left": [A]},
        {"left": "../../secret"},
        {"right": None},
        {"right": A},
        {"run": 1},
    ],
)
def test_a_damaged_line_is_named(tmp_path: Path, change: dict[str, object]) -> None:
    append_pairs(tmp_path, PAIRS)
    line = {"round": 0, "left": A, "right": B, **change}
    append_lines(tmp_path / QUEUE, [line])
    with pytest.raises(DamagedError, match=r"queries\.jsonl, line 3"):
        read_pairs(tmp_path)
