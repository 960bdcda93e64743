"""A run folder: what a run may overwrite, and what it refuses."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from training_runs import contents, copy_of, finished, new_trainer, tiny

from manip.errors import UserError
from manip.training.lifecycle import locked
from manip.training.run_folder import FILES, check_run_folder, run_folders
from manip.training.run_logs import read_metrics


def test_a_run_is_not_overwritten() -> None:
    run = finished("ppo")
    before = contents(run.folder)
    with pytest.raises(
        UserError, match=f"{run.folder} already holds a run: .*--resume"
    ):
        check_run_folder(run.config)
    assert contents(run.folder) == before


def test_a_run_that_lost_its_checkpoints_is_not_overwritten(tmp_path: Path) -> None:
    config = copy_of(finished("ppo"), tmp_path / "run")
    for path in (config.folder / "checkpoints").iterdir():
        path.unlink()
    with pytest.raises(UserError, match="is not empty, and holds no run that can be"):
        check_run_folder(config)


@pytest.mark.parametrize(
    "name",
    ["config.yaml", "metrics.csv", "run.lock", "notes", "tensorboard/x", "policy/x"],
)
def test_files_of_others_are_not_overwritten(name: str, tmp_path: Path) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine: 1\n")
    before = contents(tmp_path)
    with pytest.raises(UserError, match=f"{tmp_path} is not empty, and holds no run"):
        new_trainer(tiny("ppo", tmp_path))
    assert contents(tmp_path) == before


def test_a_config_of_another_run_is_not_overwritten(tmp_path: Path) -> None:
    config = tiny("ppo", tmp_path)
    text = (finished("ppo").folder / "config.yaml").read_text()
    (tmp_path / "config.yaml").write_text(text)
    check_run_folder(config)
    with pytest.raises(UserError, match="is not empty, and holds no run"):
        check_run_folder(replace(config, seed=1))


def test_a_run_killed_before_its_first_checkpoint_starts_again(tmp_path: Path) -> None:
    with locked(tmp_path):
        (tmp_path / ".config.partial-x.yaml").write_text("half")
        (tmp_path / "checkpoints").mkdir()
    check_run_folder(tiny("ppo", tmp_path))


LINKS: dict[str, Callable[[Path, Path], object]] = {
    "run.lock": lambda path, other: path.symlink_to(other / "file"),
    "metrics.csv": lambda path, other: path.symlink_to(other / "file"),
    "config.yaml": lambda path, other: path.symlink_to(other / "missing"),
    "eval.json": lambda path, other: path.symlink_to(other / "file"),
    "tensorboard": lambda path, other: path.symlink_to(other),
    "checkpoints": lambda path, other: path.symlink_to(other),
    "policy": lambda path, other: path.symlink_to(other),
    "dumps": lambda path, other: path.symlink_to(other),
    "policy/policy.json": lambda path, other: path.symlink_to(other / "file"),
    "tensorboard/deep/er": lambda path, other: path.symlink_to(other),
}


@pytest.mark.parametrize("name", LINKS)
@pytest.mark.parametrize("resume", [False, True])
def test_nothing_is_written_through_a_link(
    name: str, resume: bool, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    for inside in (
        "file",
        "events.out.tfevents.1",
        ".a.partial-b",
        "latest.safetensors",
    ):
        (other / inside).write_text("precious")
    config = tiny("ppo", tmp_path / "run", resume=resume)
    if resume:
        copy_of(finished("ppo"), config.folder)
    link = config.folder / name
    link.parent.mkdir(exist_ok=True, parents=True)
    if link.exists():
        link.rename(tmp_path / "away")
    LINKS[name](link, other)
    before = contents(other)
    with pytest.raises(
        UserError, match=rf"{name} is a link to .*other.*: .* remove it"
    ):
        new_trainer(config).run()
    assert contents(other) == before


@pytest.mark.parametrize(
    "name",
    ["run.lock", "metrics.csv", "notes", "checkpoints/latest.safetensors", "dumps/x"],
)
@pytest.mark.parametrize("resume", [False, True])
def test_nothing_is_written_to_a_pipe_in_a_run(
    name: str, resume: bool, tmp_path: Path
) -> None:
    """Opening a pipe to write waits for its reader, perhaps for ever."""
    config = copy_of(finished("ppo"), tmp_path / "run")
    path = config.folder / name
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    with pytest.raises(UserError, match=rf"{name} is no file: .* remove it"):
        check_run_folder(replace(config, resume=resume))


@pytest.mark.parametrize("name", FILES)
def test_a_folder_in_the_place_of_a_file_is_refused_before_training(
    name: str, tmp_path: Path
) -> None:
    config = copy_of(finished("ppo"), tmp_path / "run")
    (config.folder / name).unlink(missing_ok=True)
    (config.folder / name).mkdir()
    with pytest.raises(UserError, match=rf"{name} is a folder, where a run has a file"):
        check_run_folder(replace(config, resume=True))


def test_a_lock_with_two_names_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("precious")
    (tmp_path / "run").mkdir()
    os.link(file, tmp_path / "run" / "run.lock")
    with (
        pytest.raises(UserError, match=r"run.lock is a hard link .*: remove it"),
        locked(tmp_path / "run"),
    ):
        pytest.fail("locked")
    assert file.read_text() == "precious"


def test_other_files_with_two_names_keep_what_the_other_name_held(
    tmp_path: Path,
) -> None:
    config = copy_of(finished("ppo"), tmp_path / "run")
    other = tmp_path / "other"
    other.mkdir()
    for path in [*config.folder.rglob("*")]:
        if path.is_file() and path.name != "run.lock":
            os.link(path, other / path.name)
    before = contents(other)
    assert new_trainer(replace(config, steps=704, resume=True)).run()
    assert contents(other) == before


def test_a_lock_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("precious")
    (tmp_path / "run.lock").symlink_to(tmp_path / "file")
    with pytest.raises(OSError, match=r"run\.lock"), locked(tmp_path):
        pytest.fail("locked")
    assert (tmp_path / "file").read_text() == "precious"


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("file", "is not a folder"),
        ("file/run", "file is not a folder"),
        ("x" * 300, "no path"),
    ],
)
def test_a_folder_that_cannot_be_made_is_refused_before_any_work(
    out: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=message):
        check_run_folder(tiny("ppo", tmp_path / out))


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "env_steps\nnan\n", "env_steps\n'x\n"])
def test_a_table_without_steps_is_damaged(text: str, tmp_path: Path) -> None:
    (tmp_path / "metrics.csv").write_text(text)
    with pytest.raises(UserError, match=r"metrics\.csv is damaged"):
        read_metrics(tmp_path / "metrics.csv")


def test_a_folder_of_runs_stands_for_its_runs(tmp_path: Path) -> None:
    runs = [tmp_path / "a" / "seed0", tmp_path / "a" / "seed1"]
    swept = tmp_path / "sweep" / "runs" / "one"
    for run in (*runs, swept):
        run.mkdir(parents=True)
        (run / "config.yaml").touch()
    assert run_folders(tmp_path / "a") == runs
    assert run_folders(runs[0]) == [runs[0]]
    assert run_folders(tmp_path / "sweep") == [swept]
    assert run_folders(tmp_path / "none") == []
