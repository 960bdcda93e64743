"""Append-only files of JSON objects: torn lines, damage, several writers."""

import threading
from pathlib import Path

import pytest

from manip.errors import DamagedError
from manip.io.json_lines import append_lines, read_lines


def test_lines_come_back_in_order(tmp_path: Path) -> None:
    path = tmp_path / "file.jsonl"
    assert read_lines(path) == []
    append_lines(path, [{"a": 1}, {"b": "\n"}])
    append_lines(path, [])
    append_lines(path, [{"c": None}])
    assert read_lines(path) == [{"a": 1}, {"b": "\n"}, {"c": None}]


@pytest.mark.parametrize("torn", ["{", '{"half": tr', '{"whole": 1}', "\x00"])
def test_a_torn_last_line_is_left_out_and_cut_off(tmp_path: Path, torn: str) -> None:
    path = tmp_path / "file.jsonl"
    append_lines(path, [{"a": 1}])
    with path.open("a") as file:
        file.write(torn)
    assert read_lines(path) == [{"a": 1}]
    append_lines(path, [{"b": 2}])
    assert read_lines(path) == [{"a": 1}, {"b": 2}]


@pytest.mark.parametrize("line", ["{", "[1]", "3", "", "[" * 100_000])
def test_a_damaged_line_is_an_error(tmp_path: Path, line: str) -> None:
    path = tmp_path / "file.jsonl"
    path.write_text(f'{{"a": 1}}\n{line}\n{{"b": 2}}\n')
    with pytest.raises(DamagedError, match="line 2 is no JSON object"):
        read_lines(path)


def test_writers_do_not_mix_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "file.jsonl"
    items = [{"writer": n, "text": "x" * 5000} for n in range(8)]
    threads = [
        threading.Thread(target=append_lines, args=(path, [item] * 5)) for item in items
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    lines = read_lines(path)
    assert sorted(line["writer"] for line in lines) == sorted(list(range(8)) * 5)
