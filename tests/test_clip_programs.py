"""`manip clips` and `manip comparisons`."""

from pathlib import Path

import numpy as np
import pytest

from manip.preferences.clip_player import ClipPlayer
from manip.preferences.clips import clip_ids, clip_path, load_clip
from manip.preferences.comparisons import append_comparison, undo_last
from manip.programs import cli, main


def run(program: str, *arguments: object) -> int:
    return cli.run(main._program(program), list(map(str, arguments)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("preferences")
    options = "--count", 12, "--steps", 20, "--out", folder
    assert run("clips", "Lift", "--expert", *options) == 0
    return folder


def test_clips_of_an_expert_differ_and_repeat(folder: Path) -> None:
    clips = [load_clip(folder, clip_id) for clip_id in clip_ids(folder)]
    assert len(clips) == 12
    assert {clip.header.actor for clip in clips} == {"expert"}
    assert {clip.header.step for clip in clips} == {0, 20, 40, 60, 80}
    disturbed = [clip for clip in clips if clip.header.env == 2]
    measures, _ = ClipPlayer(folder).measure_again(disturbed[0])
    assert np.array_equal(measures, disturbed[0].measures)


def test_the_same_command_gives_the_same_clips(folder: Path, tmp_path: Path) -> None:
    options = "--count", 12, "--out", tmp_path
    assert run("clips", "Lift", "--expert", *options) == 0
    assert clip_ids(tmp_path) == clip_ids(folder)


def test_a_policy_acts_alike_without_variety(tmp_path: Path) -> None:
    options = "--count", 5, "--out", tmp_path, "--variety", 0, "--seed", 3
    assert run("clips", "Reach", *options) == 0
    actors = {load_clip(tmp_path, i).header.actor for i in clip_ids(tmp_path)}
    (actor,) = actors
    assert actor.startswith("sac policy after ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["Lift", "--count", "1"], "--count must be at least 2"),
        (["Lift", "--steps", "1"], "--steps must be at least 2"),
        (["Lift", "--steps", "101"], "longer than an episode of 100"),
        (["Lift", "--variety", "2"], "--variety must be from 0 to 1"),
        (["Lfit"], "Lfit holds no policy"),
        (["Lfit", "--expert"], "did you mean 'Lift'"),
        (["dm_control/reach_site_features", "--expert"], "batch engine"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str], message: str, tmp_path: Path, capsys
) -> None:
    assert run("clips", *arguments, "--out", tmp_path) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["Reach", "--expert"], "holds clips of Lift, Panda, OSC_POSE, 20 Hz, 20"),
        (["Lift", "--expert", "--steps", "10"], "with clips of Lift, Panda, OSC_POSE"),
    ],
)
def test_clips_of_another_kind_need_another_folder(
    arguments: list[str], message: str, folder: Path, capsys
) -> None:
    before = clip_ids(folder)
    assert run("clips", *arguments, "--count", 2, "--out", folder) == 2
    assert message in capsys.readouterr().err
    assert clip_ids(folder) == before


def test_comparisons_are_summarised(folder: Path, capsys) -> None:
    first, second = clip_ids(folder)[:2]
    append_comparison(folder, "Ada", (first, second), "left")
    append_comparison(folder, "Ada", (second, first), "right")
    append_comparison(folder, "Ben", (first, second), "equal")
    undo_last(folder, "Ben")
    assert run("comparisons", folder) == 0
    printed = capsys.readouterr().out
    rows = {line.split()[1]: line for line in printed.splitlines() if "│" in line}
    assert "1 of 1, 100%" in rows["Ada"]
    assert "none repeated" in rows["Ben"]
    assert "none repeated" in rows["between"]
    assert rows["all"].split("│")[2].strip() == "1"


def test_folders_are_merged(folder: Path, tmp_path: Path, capsys) -> None:
    append_comparison(folder, "Cleo", tuple(clip_ids(folder)[2:4]), "skip")
    assert run("comparisons", tmp_path, "--merge", folder) == 0
    assert "Cleo" in capsys.readouterr().out
    assert run("comparisons", tmp_path, "--merge", folder) == 0
    assert "0 lines appended" in capsys.readouterr().out


def test_a_clip_that_is_missing_is_named(folder: Path, tmp_path: Path, capsys) -> None:
    assert run("comparisons", tmp_path / "nowhere") == 2
    assert "there is no folder" in capsys.readouterr().err
    append_comparison(tmp_path, "Ada", ("a" * 24, "b" * 24), "left")
    assert run("comparisons", tmp_path) == 2
    assert str(clip_path(tmp_path, "a" * 24)) in capsys.readouterr().err
