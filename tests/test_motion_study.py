"""`manip study motion`: a row for each policy, and a figure."""

import csv
from pathlib import Path

import pytest

from manip.evaluation.motion import ARM_LIMITS
from manip.programs import cli, study


def test_a_row_and_a_figure_show_how_a_policy_moves(tmp_path: Path) -> None:
    arguments = ["motion", "--policies", "Reach", "--episodes", "2"]
    assert cli.run(study.main, [*arguments, "--out", str(tmp_path)]) == 0
    (row,) = csv.DictReader((tmp_path / "motion.csv").open())
    assert (row["policy"], row["task"], row["robot"]) == ("Reach", "Reach", "Panda")
    assert ARM_LIMITS[row["robot"]].jerk
    assert all(0 < float(row[name]) < 3 for name in ("speed", "torque", "jerk"))
    assert 0 < float(row["hand_tilt"]) < 90
    assert (tmp_path / "motion.png").stat().st_size > 10_000


def test_an_unknown_policy_is_named_before_any_episode(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["motion", "--policies", "Reach", "Rech", "--out", str(tmp_path)]
    assert cli.run(study.main, arguments) == 2
    printed = capsys.readouterr()
    assert "Rech" in printed.err
    assert "held" not in printed.out
