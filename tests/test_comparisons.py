"""The file of comparisons: a chain that writers, kills and merges keep whole."""

import json
import multiprocessing
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from clip_files import cut_all, recorded

from manip.errors import DamagedError, UserError
from manip.preferences.agreement import agreement
from manip.preferences.clips import Clip, clip_ids, clip_path, save_clip
from manip.preferences.comparison_record import Answer, comparison_id
from manip.preferences.comparisons import (
    COMPARISONS,
    append_comparison,
    effective,
    merge_comparisons,
    read_comparisons,
    undo_last,
    valid_comparisons,
)

A, B, C = "a" * 24, "b" * 24, "c" * 24


def answer(folder: Path, choice: Answer = "left", who: str = "Ada", **options) -> str:
    clips = options.pop("clips", (A, B))
    return append_comparison(folder, who, clips, choice, **options).id


def lines_of(folder: Path) -> list[bytes]:
    return (folder / COMPARISONS).read_bytes().splitlines(keepends=True)


def test_answers_are_read_as_they_were_given(tmp_path: Path) -> None:
    first = append_comparison(tmp_path, "Zoë B.", (A, B), "left", 2.5, 3)
    second = append_comparison(tmp_path, "oracle", (B, C), "skip")
    assert read_comparisons(tmp_path) == [first, second]
    assert (first.labeller, first.seconds, first.round) == ("Zoë B.", 2.5, 3)
    assert (first.better, second.better) == (A, "skip")
    assert first.previous == "" != second.previous
    assert first.time.endswith("+00:00")


def test_no_file_holds_no_answers(tmp_path: Path) -> None:
    assert read_comparisons(tmp_path) == []
    assert undo_last(tmp_path, "Ada") is None


# Undo


def test_undo_takes_back_the_labellers_last_answer(tmp_path: Path) -> None:
    first, second = answer(tmp_path), answer(tmp_path, "right")
    other = answer(tmp_path, who="Ben")
    undone = undo_last(tmp_path, "Ada")
    assert undone
    assert undone.id == second
    assert [each.id for each in valid_comparisons(tmp_path)] == [first, other]
    undone = undo_last(tmp_path, "Ada")
    assert undone
    assert undone.id == first
    assert undo_last(tmp_path, "Ada") is None
    assert [each.id for each in valid_comparisons(tmp_path)] == [other]
    assert len(read_comparisons(tmp_path)) == 5


def test_an_answer_after_undo_counts(tmp_path: Path) -> None:
    answer(tmp_path)
    undo_last(tmp_path, "Ada")
    again = answer(tmp_path)
    assert [each.id for each in valid_comparisons(tmp_path)] == [again]


def test_the_first_lines_are_those_of_an_earlier_time(tmp_path: Path) -> None:
    first = answer(tmp_path)
    undo_last(tmp_path, "Ada")
    records = read_comparisons(tmp_path)
    assert [each.id for each in effective(records[:1])] == [first]
    assert effective(records) == []


def rewritten(line: bytes, **values: Any) -> bytes:
    """A line with other values, and the id that fits them."""
    record = json.loads(line) | values
    if "id" not in values:
        record["id"] = comparison_id(record)
    return json.dumps(record).encode() + b"\n"


@pytest.mark.parametrize("by", ["another", "undo", "unknown"])
def test_only_an_earlier_answer_of_oneself_is_undone(by: str, tmp_path: Path) -> None:
    """An undo is not undone: the pair is answered again instead."""
    answer(tmp_path)
    undo_last(tmp_path, "Ada")
    answer(tmp_path)
    *before, last = lines_of(tmp_path)
    undone = [json.loads(line)["id"] for line in before]
    change = {
        "another": {"undoes": undone[0], "labeller": "Ben"},
        "undo": {"undoes": undone[1]},
        "unknown": {"undoes": C},
    }[by]
    (tmp_path / COMPARISONS).write_bytes(b"".join([*before, rewritten(last, **change)]))
    with pytest.raises(DamagedError, match="line 3 is damaged: it undoes no earlier"):
        read_comparisons(tmp_path)


# Damage


@pytest.mark.parametrize("cut", [1, 5, 200])
def test_a_torn_last_line_is_ignored_and_replaced(cut: int, tmp_path: Path) -> None:
    first = answer(tmp_path)
    answer(tmp_path)
    path = tmp_path / COMPARISONS
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.warns(UserWarning, match="line 2 is incomplete and was ignored"):
        assert [each.id for each in read_comparisons(tmp_path)] == [first]
    second = answer(tmp_path, "right")
    assert [each.id for each in read_comparisons(tmp_path)] == [first, second]


def test_a_removed_line_breaks_the_chain(tmp_path: Path) -> None:
    for _ in range(3):
        answer(tmp_path)
    first, _, third = lines_of(tmp_path)
    (tmp_path / COMPARISONS).write_bytes(first + third)
    with pytest.raises(DamagedError, match="line 2 is damaged: it does not follow"):
        read_comparisons(tmp_path)


def test_a_changed_answer_is_noticed(tmp_path: Path) -> None:
    answer(tmp_path)
    answer(tmp_path)
    first, second = lines_of(tmp_path)
    (tmp_path / COMPARISONS).write_bytes(first.replace(b"left", b"right", 1) + second)
    with pytest.raises(DamagedError, match="line 1 is damaged"):
        read_comparisons(tmp_path)
    (tmp_path / COMPARISONS).write_bytes(rewritten(first, answer="right") + second)
    with pytest.raises(DamagedError, match="line 2 is damaged: it does not follow"):
        read_comparisons(tmp_path)
    answer_id = json.loads(second)["id"]
    (tmp_path / COMPARISONS).write_bytes(
        first + rewritten(second, answer="equal", id=answer_id)
    )
    with pytest.raises(DamagedError, match="line 2 is damaged: its contents were"):
        read_comparisons(tmp_path)


HOSTILE: dict[str, dict[str, Any]] = {
    "answer": {"answer": "best"},
    "clip": {"left": "../../etc/passwd"},
    "itself": {"right": A},
    "escape": {"labeller": "\x1b[31mAda"},
    "name": {"labeller": " "},
    "long": {"labeller": "A" * 81},
    "seconds": {"seconds": -1},
    "nan": {"seconds": float("nan")},
    "round": {"round": 1.5},
    "time": {"time": "yesterday"},
    "zone": {"time": "2026-11-30T01:02:03+02:00"},
    "field": {"colour": "red"},
    "id": {"id": "0" * 24},
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_line_is_refused(case: str, tmp_path: Path) -> None:
    answer(tmp_path)
    (line,) = lines_of(tmp_path)
    (tmp_path / COMPARISONS).write_bytes(rewritten(line, **HOSTILE[case]))
    with pytest.raises(DamagedError, match="line 1 is damaged"):
        read_comparisons(tmp_path)


@pytest.mark.parametrize("text", [b"[]", b"{", b"\xff", b"[" * 10000, b""])
def test_a_line_that_is_no_object_is_refused(text: bytes, tmp_path: Path) -> None:
    answer(tmp_path)
    with (tmp_path / COMPARISONS).open("ab") as file:
        file.write(text + b"\n")
    with pytest.raises(DamagedError, match="line 2 is damaged"):
        read_comparisons(tmp_path)


def test_an_impossible_answer_is_not_written(tmp_path: Path) -> None:
    for clips, who in (((A, A), "Ada"), ((A, "../x"), "Ada"), ((A, B), "a\nb")):
        with pytest.raises(UserError):
            append_comparison(tmp_path, who, clips, "left")
    assert not (tmp_path / COMPARISONS).exists()


# Several writers


def _write(folder: Path, who: str, count: int) -> None:
    for _ in range(count):
        answer(folder, who=who)


def test_two_writers_make_one_chain(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    writers = [
        context.Process(target=_write, args=(tmp_path, who, 40)) for who in ("A", "B")
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    names = [each.labeller for each in read_comparisons(tmp_path)]
    assert sorted(names) == ["A"] * 40 + ["B"] * 40


def test_a_killed_writer_loses_no_confirmed_answer(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    for _ in range(10):
        before = len(read_comparisons(tmp_path))
        writer = context.Process(target=_write, args=(tmp_path, "A", 10_000))
        writer.start()
        while len(read_comparisons(tmp_path)) < before + 3:
            time.sleep(0.001)
        os.kill(writer.pid or 0, signal.SIGKILL)
        writer.join()
        answer(tmp_path, who="B")
    assert sum(each.labeller == "B" for each in read_comparisons(tmp_path)) == 10


# Merge


@pytest.fixture(scope="module")
def clips() -> list[Clip]:
    return cut_all(*recorded("Lift"))


def test_merging_adds_what_is_missing_once(clips: list[Clip], tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    ids = [save_clip(there, clip) for clip in clips[:3]]
    save_clip(here, clips[0])
    own = answer(here, clips=(ids[0], C))
    answer(there, who="Ben", clips=(ids[0], ids[1]))
    undo_last(there, "Ben")
    other = answer(there, "equal", who="Ben", clips=(ids[1], ids[2]))
    assert merge_comparisons(here, there) == 3
    assert merge_comparisons(here, there) == 0
    assert [each.id for each in valid_comparisons(here)] == [own, other]
    assert set(clip_ids(here)) == set(ids)


def test_a_merge_with_a_damaged_clip_adds_nothing(
    clips: list[Clip], tmp_path: Path
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    ids = [save_clip(there, clip) for clip in clips[:2]]
    answer(there, clips=(ids[0], ids[1]))
    path = clip_path(there, ids[0])
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(DamagedError, match="damaged"):
        merge_comparisons(here, there)
    assert read_comparisons(here) == []


def test_there_must_be_something_to_merge(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="holds no comparisons"):
        merge_comparisons(tmp_path, tmp_path / "nothing")


# Agreement


def test_agreement_of_a_small_example(tmp_path: Path) -> None:
    """Ada answers A-B three times: left, the same swapped, then differently; and B-C
    twice as equal. Ben answers A-B as Ada did last, B-C differently.
    """
    answer(tmp_path, "left")
    answer(tmp_path, "right", clips=(B, A))
    answer(tmp_path, "right")
    answer(tmp_path, "equal", clips=(B, C))
    answer(tmp_path, "skip", clips=(B, C))
    answer(tmp_path, "equal", clips=(C, B))
    answer(tmp_path, "left", who="Ben", clips=(B, A))
    answer(tmp_path, "left", who="Ben", clips=(B, C))
    result = agreement(valid_comparisons(tmp_path))
    assert (result.within.same, result.within.total) == (2, 3)
    assert (result.between.same, result.between.total) == (1, 2)
    assert result.by_labeller["Ben"].rate is None
    assert result.within.rate
    assert result.within.rate.rate == pytest.approx(2 / 3)
    assert result.within.rate.low == pytest.approx(0.2077, abs=1e-4)  # Wilson
    assert result.within.rate.high == pytest.approx(0.9385, abs=1e-4)
