"""Printing never loses work, and paths of results are checked before the work."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from manip.errors import UserError
from manip.io.output_paths import check_output, check_output_folder
from manip.io.printable import MOST, printable
from manip.programs import cli

ROOT = Path(__file__).parents[1]

PROGRAM = """
import sys
from pathlib import Path
from manip.programs import cli

def program(arguments):
    Path("saved").write_text("work")
    for _ in range(20_000):
        print("Reach \\u00b7 Panda")
    print("message", file=sys.stderr)
    return int(arguments[0])

sys.exit(cli.run(program, sys.argv[1:]))
"""


def run_program(code: int, folder: Path, shell: str, **environment: str) -> int:
    """Exit code of a program that saves, prints much, and returns `code`."""
    (folder / "program.py").write_text(PROGRAM)
    command = shell.format(f"{sys.executable} program.py {code}")
    done = subprocess.run(
        ["bash", "-c", f"{command}; exit ${{PIPESTATUS[0]}}"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
    )
    assert (folder / "saved").read_text() == "work"
    assert b"Traceback" not in done.stderr
    assert b"Exception ignored" not in done.stderr
    return done.returncode


@pytest.mark.parametrize("code", [0, 3])
@pytest.mark.parametrize(
    "shell", ["{} | head -1", "{} >&-", "{} 2>&-", "{} >&- 2>&-", "{} 2>&1 | true"]
)
def test_the_exit_code_is_the_same_without_a_reader(shell, code, tmp_path) -> None:
    assert run_program(code, tmp_path, shell) == code


def test_a_full_disk_under_stdout_is_an_error(tmp_path: Path) -> None:
    assert run_program(0, tmp_path, "{} > /dev/full") == 2
    assert run_program(3, tmp_path, "{} > /dev/full") == 3


def test_a_terminal_without_the_characters_shows_others(tmp_path: Path) -> None:
    ascii_only = {"PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    assert run_program(0, tmp_path, "{} > shown", **ascii_only) == 0
    assert (tmp_path / "shown").read_text().startswith("Reach ? Panda\n")


def test_every_allocator_that_fails_is_told_in_one_line(capsys) -> None:
    def program(arguments: object) -> int:
        raise RuntimeError("[alloc_cpu.cpp:127] DefaultCPUAllocator: can't allocate 9")

    assert cli.run(program, []) == 2
    error = capsys.readouterr().err
    assert error.startswith("manip: error: not enough memory: ")
    assert error.count("\n") == 1


def test_other_errors_are_not_hidden() -> None:
    def program(arguments: object) -> int:
        raise RuntimeError("a bug")

    with pytest.raises(RuntimeError, match="a bug"):
        cli.run(program, [])


def test_text_of_a_file_is_inert() -> None:
    assert printable("a\x1b[2Jb\nc\u202ed") == r"a\x1b[2Jb\nc\u202ed"
    assert printable("Lift · Jaco é") == "Lift · Jaco é"
    assert len(printable("x" * 10**6)) == MOST


def test_an_error_message_cannot_steer_the_terminal(capsys) -> None:
    def program(arguments: object) -> int:
        raise UserError("no task \x1b]0;owned\x07 here")

    assert cli.run(program, []) == 2
    assert "\x1b" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "known", "nearest"),
    [
        ("--lr", ["--agent.learning-rate", "--agent.n-step"], "--agent.learning-rate"),
        ("--agent.lr", ["--agent.learning-rate"], "--agent.learning-rate"),
        ("--learning_rate", ["--agent.learning-rate"], "--agent.learning-rate"),
        ("--epsiodes", ["--episodes", "--seed"], "--episodes"),
        ("--zzz", ["--episodes", "--seed"], None),
    ],
)
def test_the_nearest_option_is_named(given, known, nearest) -> None:
    assert cli.nearest_option(given, known) == nearest


def test_a_path_that_can_be_written_is_taken(tmp_path: Path) -> None:
    check_output(tmp_path / "a" / "b" / "new.json", "--json")
    (tmp_path / "old.json").write_text("")
    check_output(tmp_path / "old.json", "--json")
    check_output(Path("/dev/null"), "--json")
    check_output_folder(tmp_path / "new" / "folder", "--out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["old.json"]


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("", "is a folder: name a file"),
        ("file/x.json", "file is not a folder"),
        ("/proc/x.json", "/proc is not writable"),
        ("x" * 300, "is no path: .*name too long"),
        ("x\0y", "is no path: embedded null byte"),
        ("film.avi", "unknown file format '.avi': known file formats: .mp4, .gif"),
    ],
)
def test_a_path_that_cannot_be_written_is_refused(path, message, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    suffixes = (".mp4", ".gif") if path.endswith(".avi") else ()
    with pytest.raises(UserError, match=message):
        check_output(tmp_path / path, "--json", suffixes)


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="file is not a folder"):
        check_output_folder(tmp_path / "file", "--out")
    with pytest.raises(UserError, match="file is not a folder"):
        check_output_folder(tmp_path / "file" / "below", "--out")
