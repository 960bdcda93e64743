"""`manip compare` and `manip train --seeds`: runs side by side."""

import csv
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from manip.evaluation.statistics import SeedCount, difference_of_rates, wilson_rate
from manip.io.csv_text import csv_text
from manip.programs import cli, compare, train
from manip.studies.compare_figure import curve
from manip.studies.run_groups import groups_of, load_runs
from manip.training.config import to_dict
from manip.training.recipes import recipe
from manip.training.run_logs import read_metrics


def make_run(
    folder: Path,
    seed: int = 0,
    held: float = 0.5,
    *,
    old: bool = False,
    result: Mapping[str, Any] | None = None,
    **changes: Any,
) -> Path:
    """A run folder with a light evaluation and one that chooses the policy."""
    config = replace(recipe("Reach", "sac"), seed=seed, out=folder, **changes)
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(yaml.safe_dump(to_dict(config)))
    rows: list[dict[str, float]] = [
        {"env_steps": 4000, "seconds": 5.0, "curve/success_held": held / 2},
        {"env_steps": 8000, "seconds": 9.0, "eval/success_held": held},
    ]
    for row in rows:
        row["train/success" if old else "train/success_held"] = held
        row["eval/return"] = row["train/return"] = 10 * held
    kept = rows[1:] if old else rows
    columns = list(dict.fromkeys(name for row in kept for name in row))
    (folder / "metrics.csv").write_text(csv_text(columns, kept))
    if result:
        (folder / "eval.json").write_text(json.dumps(result))
    return folder


def test_runs_of_equal_options_are_a_group(tmp_path: Path) -> None:
    for seed in (1, 0):
        make_run(tmp_path / "a" / f"seed{seed}", seed)
    make_run(tmp_path / "b", steps=9_000, eval_every=100, threads=1)
    make_run(tmp_path / "c", cool_down=0.0, steps=9_000)
    make_run(tmp_path / "again", seed=1)
    folders = [tmp_path / name for name in ("a", "b", "c", "again")]
    groups = groups_of(load_runs(folders))
    assert [[run.seed for run in group.runs] for group in groups] == [
        [0, 1],
        [0],
        [0],
        [1],
    ]
    names = [group.name for group in groups]
    assert names[1:3] == [
        "Reach sac steps=9000 cool_down=0.4",
        "Reach sac steps=9000 cool_down=0.0",
    ]
    assert names[3] == f"Reach sac steps=8000 cool_down=0.4 ({tmp_path / 'again'})"


def test_a_curve_is_of_the_steps_that_all_seeds_have(tmp_path: Path) -> None:
    runs = load_runs([make_run(tmp_path / "0"), make_run(tmp_path / "1", 1, 0.8)])
    steps, values = curve(runs, ("eval/success_held", "curve/success_held"))
    np.testing.assert_array_equal(steps, [4000, 8000])
    np.testing.assert_allclose(values, [[0.25, 0.5], [0.4, 0.8]])
    steps, values = curve(runs, ("learn/none",))
    assert steps.shape == (0,)
    assert values.shape == (1, 0)


def test_the_difference_of_rates_has_an_interval(tmp_path: Path) -> None:
    """Newcombe 1998, table II, row a, method 10: 56 of 70 and 48 of 80."""
    difference = difference_of_rates([SeedCount(56, 70)], [SeedCount(48, 80)])
    assert difference.rate == pytest.approx(0.2)
    assert difference.low == pytest.approx(0.0524, abs=5e-4)
    assert difference.high == pytest.approx(0.3339, abs=5e-4)


def test_options_success_and_curves_are_shown(tmp_path: Path, capsys) -> None:
    for seed in (0, 1, 2):
        make_run(tmp_path / "a" / f"seed{seed}", seed, held=0.5)
    old = make_run(tmp_path / "old", held=0.875, cool_down=0.0, old=True)
    files = [tmp_path / name for name in ("curves.png", "table.csv")]
    options = [tmp_path / "a", old, "--out", *files]
    assert cli.run(compare.main, [*map(str, options)]) == 0
    shown = capsys.readouterr().out
    assert "cool_down" in shown
    assert "success_held (training), mean over seeds [95 % interval]" in shown
    assert "difference [points]" in shown
    first, second = csv.DictReader(files[1].read_text().splitlines())
    assert (first["seeds"], float(first["success_held"])) == ("3", 0.5)
    assert first["difference"] == ""
    assert float(second["difference"]) == pytest.approx(0.375)
    assert float(second["success_held_low"]) == pytest.approx(wilson_rate(28, 32).low)
    assert np.asarray(Image.open(files[0])).std() > 0


def test_final_evaluations_count_where_there_are_some(tmp_path: Path, capsys) -> None:
    stock = {
        "success": {"success_held": {"rate": 0.25}},
        "episodes": 100,
        "env": "stock",
    }
    runs = [make_run(tmp_path / "0", result=stock), make_run(tmp_path / "1", 1)]
    assert cli.run(compare.main, [str(runs[0])]) == 0
    assert "success_held (stock)" in capsys.readouterr().out
    assert cli.run(compare.main, [*map(str, runs)]) == 2
    assert "runs were evaluated in different ways" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "manip compare needs the folder of a run"),
        ("none", "none holds no run: name a run folder"),
        ("run run", "run is given twice"),
        ("damaged", "damaged/config.yaml: unknown algorithm 'none'"),
        ("run --out a.txt", "--out a.txt: unknown file format"),
    ],
)
def test_mistakes_are_one_line(
    arguments: str, message: str, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    make_run(Path("run"))
    Path("damaged").mkdir()
    Path("damaged/config.yaml").write_text("algo: none\n")
    assert cli.run(compare.main, arguments.split()) == 2
    assert message in capsys.readouterr().err


TINY = (
    "--task Reach --algo ppo --steps 64 --num-envs 4 --horizon 20 --eval-episodes 2 "
    "--agent.rollout-length 8 --agent.epochs 1"
)


def test_several_seeds_train_in_ordinary_run_folders(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr("manip.cluster.executors.usable_cpus", lambda: 1)
    arguments = [*TINY.split(), "--seeds", "3", "5", "--out", str(tmp_path / "runs")]
    for _ in range(2):  # the second time, all have finished
        assert cli.run(train.main, arguments) == 0
    assert f"manip compare {tmp_path / 'runs'}" in capsys.readouterr().err
    (group,) = groups_of(load_runs([tmp_path / "runs"]))
    assert [run.folder.name for run in group.runs] == ["seed3", "seed5"]
    assert [run.seed for run in group.runs] == [3, 5]
    rows = read_metrics(tmp_path / "runs" / "seed3" / "metrics.csv")
    assert {"32", "64"} <= {row["env_steps"] for row in rows}


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("--seeds 1 1", "--seeds holds a seed twice: 1 1"),
        ("--seeds 0 1 --preferences x --labels.labeller people", "--seeds has no use"),
        ("--seeds -1 2", "seeds must be at least 0, not -1"),
    ],
)
def test_seeds_that_cannot_train_side_by_side_are_refused(
    more: str, message: str, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = [*TINY.replace("ppo", "ppo-kl").split(), *more.split()]
    assert cli.run(train.main, arguments) == 2
    assert message in capsys.readouterr().err
