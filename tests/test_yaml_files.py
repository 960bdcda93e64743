"""YAML files: plain values come back, and no file takes long or expands."""

import os
from pathlib import Path

import pytest

from manip.errors import UserError
from manip.io.yaml_files import LARGEST, dump_yaml, read_yaml
from manip.training.config import recorded

PLAIN = {"a": 1, "b": [1.5, "x", None, True], "c": {"d": []}, "e": "&x *y << #"}

BOMB = "a0: &a0 {k: v}\n" + "".join(
    f"a{n + 1}: &a{n + 1} {{<<: [{', '.join([f'*a{n}'] * 9)}]}}\n" for n in range(10)
)


def test_plain_values_come_back(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    shared = [1, 2]
    for values in (PLAIN, {"a": shared, "b": shared}, [], "text", None):
        path.write_text(dump_yaml(values))
        assert read_yaml(path) == values


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, r"anchors and aliases \(&, \*\) are not allowed"),
        ("a: &x 1", "anchors and aliases"),
        ("a: *x", "anchors and aliases"),
        ("<<: {a: 1}", r"merge keys \(<<\) are not allowed"),
        ("a: {<<: [{b: 1}]}", "merge keys"),
        ("a: 1\na: 2", "a key stands there twice"),
        ("a: {b: 1, b: 1}", "a key stands there twice"),
        ("a: [", "while parsing"),
        ("[" * 20_000, "recursion"),
        ("? {a: 1}\n: 2", "unhashable"),
        ("a: !!python/object:os.system {}", "could not determine a constructor"),
        ("a: " + "9" * 5000, "4300 digits"),
        ("a: 2020-13-45", "month"),
    ],
)
def test_other_files_are_refused_in_a_line(text, message, tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(text)
    for read in (lambda: read_yaml(path), lambda: recorded(tmp_path)):
        with pytest.raises(UserError, match=f"{path} is damaged: .*{message}") as error:
            read()
        assert "\n" not in str(error.value)


def test_large_files_and_pipes_are_refused(tmp_path: Path) -> None:
    (tmp_path / "large").write_text("#" * (LARGEST + 1))
    os.mkfifo(tmp_path / "pipe")
    for name, message in (("large", "is larger than"), ("pipe", "is not a regular")):
        with pytest.raises(UserError, match=message):
            read_yaml(tmp_path / name)
    (tmp_path / "bytes").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match="is damaged"):
        read_yaml(tmp_path / "bytes")
