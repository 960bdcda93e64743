"""Options of `manip label`."""

from pathlib import Path

import pytest
from clip_files import cut_all, recorded

from manip.errors import UserError
from manip.preferences.clips import save_clip
from manip.programs.label import Label, check, settings_of


def test_the_question_is_about_the_task_and_the_taste(tmp_path: Path) -> None:
    assert settings_of(Label(tmp_path)).question == "Which clip is better?"
    save_clip(tmp_path, cut_all(*recorded("Lift", steps=8, num_envs=1))[0])
    assert settings_of(Label(tmp_path)).question == "Which is the better Lift?"
    gentle = settings_of(Label(tmp_path, taste="gentle")).question
    assert gentle.startswith("Which is the better Lift? Move slowly and smoothly")
    own = Label(tmp_path, taste="gentle", question="Which is slower?")
    assert settings_of(own).question == "Which is slower?"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pairs": 0}, "--pairs must be at least 1"),
        ({"port": 70_000}, "--port must be at most 65535"),
        ({"repeats": 0.6}, "--repeats must be from 0 to 0.5"),
        ({"repeats": float("nan")}, "--repeats must be from 0 to 0.5"),
        ({"labeller": " "}, "name must have 1 to 80"),
    ],
)
def test_options_out_of_range(tmp_path: Path, options: dict, message: str) -> None:
    with pytest.raises(UserError, match=message):
        check(Label(tmp_path, **options))


def test_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no folder"):
        check(Label(tmp_path / "none"))
