"""Studies: what they measure, on numbers that are known; the program."""

import csv
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest
import torch
import yaml
from toy import QUICK_A2C, Points, make_agent

from manip.io.atomic_files import write_text
from manip.programs import cli, study
from manip.studies import gradients
from manip.studies.gradients import _compare, _sample, _squared_mean
from manip.studies.learning import algorithm_variants
from manip.training.collector import Rollout
from manip.training.config import to_dict


def test_a_squared_mean_is_estimated_without_bias() -> None:
    draw = torch.Generator().manual_seed(0)
    mean = torch.tensor([0.3, 0.0, -0.4])
    found = [
        _squared_mean(mean + 0.1 * torch.randn(5, 3, generator=draw))
        for _ in range(4000)
    ]
    assert torch.stack(found).mean().item() == pytest.approx(0.25, rel=0.01)


def test_noise_and_bias_are_relative_to_the_reference() -> None:
    """Reference: mean (3, 4), variance 2 x 1; the other is off by (1, 0)."""
    draw = torch.Generator().manual_seed(0)
    reference = torch.tensor([3.0, 4.0]) + torch.randn(20_000, 2, generator=draw)
    noise, bias = _compare(reference, reference)
    assert noise == pytest.approx(2 / 25, rel=0.03)
    assert bias == 0
    shifted = 3 * (reference - reference.mean(0)) + reference.mean(0)
    noise, bias = _compare(shifted + torch.tensor([1.0, 0.0]), reference)
    assert noise == pytest.approx(9 * 2 / 25, rel=0.03)
    assert bias == pytest.approx(1 / 25, rel=0.05)


def test_a_baseline_takes_noise_away_and_the_longest_n_is_the_return() -> None:
    agent = make_agent(QUICK_A2C, seed=0)
    env = Points([32] * 16)
    rollout = Rollout(env)
    for _ in range(60):
        agent.update(rollout.collect(agent.policy(), 8).batch)
    found = _sample(agent, env, count=30, horizon=32, length=8)
    torch.testing.assert_close(found["n = 32"], found[gradients.BASELINE])
    noise = {name: sample.var(0).sum() for name, sample in found.items()}
    assert noise[gradients.BASELINE] < 0.5 * noise["R"]
    assert noise["n = 1"] < noise[gradients.BASELINE]


def test_algorithms_are_evaluated_after_each_fifth() -> None:
    found = algorithm_variants("Reach", ["a2c", "sac"], 10_000)
    assert {(config.steps, config.eval_every) for config in found.values()} == {
        (10_000, 2_000)
    }


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("gradients --rollouts 1", "--rollouts must be at least 2"),
        ("gradients --length 49", "--length must be at most 48, not 49"),
        ("gradients --stages", "--stages must name at least one"),
        ("clipping --steps 0", "--steps must be at least 1"),
        ("clipping --tasks", "--tasks must name at least one"),
        ("algorithms --algos", "--algos must name at least one"),
        ("algorithms --algos ddqn", "ddqn"),
    ],
)
def test_wrong_options_are_told(
    arguments: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [*arguments.split(), "--out", str(tmp_path)]
    assert cli.run(study.main, command) == 2
    assert told in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]


@pytest.fixture
def one_run(tmp_path: Path) -> list[str]:
    """The arguments of a study whose only run is there already."""
    (config,) = algorithm_variants("Reach", ["a2c"], 640).values()
    run = replace(config, out=tmp_path / "runs" / "Reach-a2c-0")
    plain = yaml.safe_dump(to_dict(run))
    write_text(run.folder / "config.yaml", plain)
    rows = "".join(f"{128 * i},{i},0.5\n" for i in range(1, 6))
    write_text(
        run.folder / "metrics.csv", f"env_steps,cpu_seconds,eval/success_held\n{rows}"
    )
    options = ["algorithms", "--algos", "a2c", "--seeds", "1", "--steps"]
    return ["--out", str(tmp_path), *options]


def test_a_run_that_is_there_is_read(one_run: list[str], tmp_path: Path) -> None:
    assert cli.run(study.main, [*one_run, "640"]) == 0
    assert len((tmp_path / "algorithms.csv").read_text().splitlines()) == 1 + 5


def test_a_run_of_other_options_is_refused(
    one_run: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(study.main, [*one_run, "320"]) == 2
    assert "Reach-a2c-0 holds a run with other options" in capsys.readouterr().err


@pytest.mark.parametrize("damage", ["steps,held\n1,2\n", "env_steps\nsoon\n", "\xff"])
def test_a_damaged_run_is_told(
    damage: str,
    one_run: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "runs" / "Reach-a2c-0" / "metrics.csv"
    path.write_bytes(damage.encode("latin-1") + b"\n")
    assert cli.run(study.main, [*one_run, "640"]) == 2
    assert "metrics.csv is damaged" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "options", "rows", "pictures"),
    [
        (
            "gradients",
            ["--stages", "0", "512", "--rollouts", "4"],
            2 * 2 * 8,
            ("variance", "bias"),
        ),
        ("clipping", ["--steps", "4096"], 2 * 6, ("clipping",)),
    ],
)
def test_a_study_leaves_a_table_and_its_pictures(
    what: str, options: list[str], rows: int, pictures: Sequence[str], tmp_path: Path
) -> None:
    arguments = [what, "--seeds", "2", "--out", str(tmp_path), *options]
    assert cli.run(study.main, arguments) == 0
    with (tmp_path / f"{what}.csv").open() as file:
        found = list(csv.DictReader(file))
    assert len(found) >= rows
    assert {row["seed"] for row in found} == {"0", "1"}
    pairs = [(row["seed"], row.get("weight") or row["variant"]) for row in found]
    assert set(pairs) == set(product(*map(set, zip(*pairs, strict=True))))
    for name in pictures:
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
