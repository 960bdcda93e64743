"""Studies: their statistics on known distributions, their figures, the program."""

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from matplotlib import pyplot as plt
from toy import QUICK_A2C, Points, make_agent

from manip.cluster.job import JobResult, write_result
from manip.io.atomic_files import write_text
from manip.programs import cli, study
from manip.studies import gradient_figures, gradients, plotting
from manip.studies.bootstrap import compare, squared_mean
from manip.studies.gradients import GradientRow, _sample
from manip.studies.learning import algorithm_variants
from manip.training.collector import Rollout
from manip.training.config import to_dict

DRAW = torch.Generator()


def normal(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=DRAW)


@pytest.fixture(autouse=True)
def _seeded() -> None:
    DRAW.manual_seed(0)


def test_a_squared_mean_is_estimated_without_bias() -> None:
    mean = torch.tensor([0.3, 0.0, -0.4])
    estimates = [squared_mean(mean + 0.1 * normal(5, 3)) for _ in range(1000)]
    assert np.mean(estimates) == pytest.approx(0.25, rel=0.01)


def test_noise_and_bias_are_relative_to_the_reference() -> None:
    """Reference: mean (3, 4), variance 2 x 1; the other mean is off by (1, 0)."""
    reference = torch.tensor([3.0, 4.0]) + normal(400, 2)
    reference += torch.tensor([3.0, 4.0]) - reference.mean(0)
    result = compare(reference, reference)
    assert result.noise.value == pytest.approx(2 / 25, rel=0.1)
    assert result.bias.value == 0 == result.floor
    shifted = 3 * (reference - reference.mean(0)) + torch.tensor([4.0, 4.0])
    result = compare(shifted, reference)
    assert result.noise.value == pytest.approx(9 * 2 / 25, rel=0.1)
    assert result.bias.value == pytest.approx(1 / 25, rel=0.2)
    assert result.bias.low > result.floor > 0


def samples(bias: float) -> tuple[torch.Tensor, torch.Tensor]:
    """60 gradients of 10 parameters and their reference, which share no noise."""
    reference = 1.0 + normal(60, 10)
    return reference + bias + normal(60, 10), reference


@pytest.mark.parametrize("bias", [0.3, 0.6])
def test_intervals_hold_the_true_bias_and_noise(bias: float) -> None:
    """Noise (1 + 1) 10 / 10, squared bias b^2 10 / 10, relative to |mean|^2 = 10."""
    results = [compare(*samples(bias)) for _ in range(100)]
    for name, truth in (("bias", bias**2), ("noise", 2.0)):
        intervals = [getattr(result, name) for result in results]
        assert np.mean([i.low <= truth <= i.high for i in intervals]) > 0.87


def test_without_bias_one_estimate_in_twenty_exceeds_the_noise_floor() -> None:
    results = [compare(*samples(0.0)) for _ in range(100)]
    exceeded = np.mean([result.bias.value > result.floor for result in results])
    assert 0.0 < exceeded < 0.13


def test_a_gradient_that_is_lost_in_noise_is_missing() -> None:
    reference = normal(8, 3)
    reference -= reference.mean(0)
    result = compare(reference + 1, reference)
    assert np.isnan([result.noise.value, result.bias.value, result.floor]).all()


@pytest.mark.slow
def test_a_baseline_reduces_noise_and_the_longest_n_is_the_return() -> None:
    agent = make_agent(QUICK_A2C, seed=0)
    env = Points([32] * 16)
    rollout = Rollout(env)
    for _ in range(60):
        agent.update(rollout.collect(agent.policy(), 8).batch)
    result = _sample(agent, env, count=30, horizon=32, length=8)
    torch.testing.assert_close(result["n = 32"], result[gradients.BASELINE])
    noise = {name: sample.var(0).sum() for name, sample in result.items()}
    assert noise[gradients.BASELINE] < 0.5 * noise["R"]
    assert noise["n = 1"] < noise[gradients.BASELINE]


def row(weight: str, seed: int, noise: float, high: float) -> GradientRow:
    values = noise, noise / 2, high, noise, 0.0, high, 0.1
    return GradientRow("Reach", seed, 5000 * (1 + seed), weight, *values)


@pytest.mark.parametrize(("noise", "high"), [(math.nan, math.nan), (3.0, math.nan)])
def test_missing_values_are_left_out_of_figures_and_tables(
    noise: float, high: float, tmp_path: Path
) -> None:
    weights = ["R", "R - V", *(f"n = {n}" for n in gradients.NS)]
    rows = [row(weight, seed, noise, high) for seed in (0, 1) for weight in weights]
    for draw in (gradient_figures.draw_variance, gradient_figures.draw_bias):
        draw(rows, tmp_path / "figure.png")
        assert (tmp_path / "figure.png").stat().st_size > 10_000
    assert not re.search("nan|inf", study._table(rows))


@pytest.mark.parametrize("low", [0.011, 1.0, 7.0])
@pytest.mark.parametrize("factor", [1.05, 2.2, 9.0, 30.0, 1e7])
def test_labels_of_a_logarithmic_axis_do_not_overlap(low: float, factor: float) -> None:
    figure, axes = plt.subplots(figsize=(4, 3), layout="constrained")
    axes.plot([low, low * factor], [1, 2])
    axes.set_xscale("log")
    plotting.label_log_axis(axes.xaxis)
    figure.canvas.draw()
    labels = [label for label in axes.get_xticklabels(which="both") if label.get_text()]
    boxes = sorted((box.x0, box.x1) for box in (x.get_window_extent() for x in labels))
    plt.close(figure)
    assert 2 <= len(labels) <= 8
    assert all(end < start for (_, end), (start, _) in pairwise(boxes))


def test_algorithms_that_learn_from_rewards_are_compared() -> None:
    algos = study.reward_algorithms()
    assert {"sac", "ppo", "ppo-kl", "dqn"} <= set(algos)
    assert not {"bc", "gaussian-bc", "dpo", "clone-best", "pebble"} & set(algos)


def test_algorithms_are_evaluated_after_each_fifth() -> None:
    result = algorithm_variants("Reach", ["a2c", "sac"], 10_000)
    assert {(config.steps, config.eval_every) for config in result.values()} == {
        (10_000, 2_000)
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("gradients --rollouts 7", "--rollouts must be at least 8"),
        ("gradients --stages -5", "--stages must be at least 0"),
        ("gradients --gamma 2", "--gamma must be from 0 to 1"),
        ("gradients --length 49", "--length must be at most 48, not 49"),
        ("gradients --stages", "--stages must name at least one"),
        ("clipping --steps 0", "--steps must be at least 1"),
        ("rlhf --parts", "--parts must name at least one"),
        ("rlhf --taste loud", "gentle"),
        ("rlhf --steps 1000", "--steps must be at least 16384"),
        ("algorithms --algos", "--algos must name at least one"),
        ("algorithms --algos ddqn", "ddqn"),
    ],
)
def test_wrong_options_are_refused(
    arguments: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [*arguments.split(), "--out", str(tmp_path)]
    assert cli.run(study.main, command) == 2
    assert message in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]


@pytest.fixture
def one_run(tmp_path: Path) -> list[str]:
    """The arguments of a study whose only run is finished."""
    (config,) = algorithm_variants("Reach", ["a2c"], 640).values()
    run = replace(config, out=tmp_path / "runs" / "Reach-a2c-0")
    plain = yaml.safe_dump(to_dict(run))
    write_text(run.folder / "config.yaml", plain)
    rows = "".join(f"{128 * i},{i},0.5\n" for i in range(1, 6))
    write_text(
        run.folder / "metrics.csv", f"env_steps,cpu_seconds,eval/success_held\n{rows}"
    )
    write_result(run.folder, JobResult(env_steps=640, seconds=1.0, training={}))
    options = ["algorithms", "--algos", "a2c", "--seeds", "1", "--steps"]
    return ["--out", str(tmp_path), *options]


def test_a_finished_run_is_not_repeated(one_run: list[str], tmp_path: Path) -> None:
    assert cli.run(study.main, [*one_run, "640"]) == 0
    assert len((tmp_path / "algorithms.csv").read_text().splitlines()) == 1 + 5


def test_a_run_with_other_options_is_refused(
    one_run: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(study.main, [*one_run, "320"]) == 2
    assert "Reach-a2c-0 holds a run with other options" in capsys.readouterr().err


@pytest.mark.parametrize("damage", ["steps,held\n1,2\n", "env_steps\nsoon\n", "\xff"])
def test_a_damaged_table_is_refused(
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
            ["--stages", "0", "512", "--rollouts", "8"],
            2 * 2 * 8,
            ("variance", "bias"),
        ),
        ("clipping", ["--steps", "4096"], 2 * 6, ("clipping",)),
        ("asynchrony", ["--steps", "1600"], 2 * 3, ("asynchrony",)),
    ],
)
def test_a_study_writes_a_table_and_figures(
    what: str, options: list[str], rows: int, pictures: Sequence[str], tmp_path: Path
) -> None:
    arguments = [what, "--seeds", "2", "--out", str(tmp_path), *options]
    assert cli.run(study.main, arguments) == 0
    with (tmp_path / f"{what}.csv").open() as file:
        result = list(csv.DictReader(file))
    assert len(result) >= rows
    assert {row["seed"] for row in result} == {"0", "1"}
    pairs = [(row["seed"], row.get("weight") or row["variant"]) for row in result]
    assert set(pairs) == set(product(*map(set, zip(*pairs, strict=True))))
    for name in pictures:
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
