"""Studies: what they measure, on numbers that are known; the program."""

import csv
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import pytest
import torch
from toy import QUICK_A2C, Points, make_agent

from manip.programs import cli, study
from manip.studies import gradients
from manip.studies.gradients import _compare, _sample, _squared_mean
from manip.training.rollout import Rollout


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
    rollout = Rollout(Points([20] * 16))
    for _ in range(20):
        agent.update(rollout.collect(agent.policy(), 8).batch)
    found = _sample(agent, rollout, count=30, length=20)
    torch.testing.assert_close(found["n = 32"], found[gradients.BASELINE])
    noise = {name: sample.var(0).sum() for name, sample in found.items()}
    assert noise[gradients.BASELINE] < 0.5 * noise["R"]
    assert noise["n = 1"] < noise[gradients.BASELINE]


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
