"""The demo continues its own run, and removes nothing but its own files."""

from pathlib import Path

import pytest

from manip.errors import UserError
from manip.programs import cli, demo
from manip.programs.demo_folder import OWN, is_unfinished, remove_finished


def finished_demo(folder: Path) -> Path:
    """A folder with all names that a demo leaves."""
    folder.mkdir()
    for name in OWN:
        (folder / name).write_text("")
    (folder / "checkpoints").unlink()
    (folder / "checkpoints").mkdir()
    for name in ("latest", "step-64"):
        (folder / "checkpoints" / f"{name}.safetensors").write_text("")
    return folder


def test_a_finished_demo_is_removed(tmp_path: Path) -> None:
    remove_finished(finished_demo(tmp_path / "demo"))
    assert not (tmp_path / "demo").exists()


def test_a_folder_with_other_files_is_left_alone(tmp_path: Path) -> None:
    folder = finished_demo(tmp_path / "demo")
    (folder / "thesis.tex").write_text("years of work")
    with pytest.raises(UserError, match=r"holds thesis.tex besides an earlier demo"):
        remove_finished(folder)
    assert {path.name for path in folder.iterdir()} == {*OWN, "thesis.tex"}


def test_a_folder_without_a_run_is_left_to_the_training(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("mine: true")
    remove_finished(tmp_path)
    assert not is_unfinished(tmp_path, 64)
    assert (tmp_path / "config.yaml").read_text() == "mine: true"


def test_a_linked_folder_is_refused(tmp_path: Path) -> None:
    folder = finished_demo(tmp_path / "elsewhere")
    (tmp_path / "demo").symlink_to(folder)
    with pytest.raises(UserError, match="is a link"):
        remove_finished(tmp_path / "demo")
    assert folder.exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--out", "/dev/null"), "--out /dev/null is not a folder"),
        (("--episodes", "0"), "--episodes must be at least 1, not 0"),
        (("--episodes", "1000000"), "--episodes must be at most 100000"),
        (("--seed", "-1"), "--seed must be at least 0, not -1"),
    ],
)
def test_the_demo_refuses_before_it_trains(options, message, capsys) -> None:
    assert cli.run(demo.main, options) == 2
    assert capsys.readouterr().err.startswith(f"manip: error: {message}")
