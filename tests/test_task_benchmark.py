"""The benchmark of whole tasks: medians, processes, evaluation in stock robosuite."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from training_runs import tiny

from manip.benchmarks import bench_task as benchmark
from manip.benchmarks.time_to_success import TimedRun, figures, median_time, summary
from manip.envs.task_registry import load_task
from manip.evaluation import runners as evaluate
from manip.evaluation.statistics import Rate
from manip.programs import cli
from manip.programs.benchmark_task import main
from manip.training.config import TrainConfig


def timed(seconds: float, rate: float, learner: str = "manip SAC") -> TimedRun:
    return TimedRun(learner, 0, seconds, int(1000 * seconds), Rate(rate, 0.0, 1.0))


def test_a_seed_that_misses_the_goal_counts_as_infinite() -> None:
    assert median_time([timed(10, 1), timed(1, 0.94), timed(20, 0.95)]) == 20
    assert median_time([timed(1, 0.9), timed(1, 0.9), timed(2, 1)]) == float("inf")


def test_figures_distinguish_failures_from_times() -> None:
    result = figures([timed(10, 1.0), timed(30, 1.0)], [timed(600, 0.2, "SB3")])
    assert result["seconds_to_held"] == 20
    assert result["env_steps_to_held"] == 20_000
    assert result["sb3_seconds_to_held"] is None
    assert result["sb3_times_longer_at_least"] == 30
    missed = figures([timed(10, 0.5)], [])
    assert missed["seconds_to_held"] is None
    assert (missed["seeds_reached"], missed["seeds"]) == (0, 1)
    json.dumps([result, missed], allow_nan=False)


def test_a_run_is_summarised_in_one_line() -> None:
    missed = summary(timed(600, 0.25, "SB3 SAC"))
    assert missed == (
        "SB3 SAC: goal missed after 10 min: success_held 25% after 600,000 steps"
    )
    assert summary(timed(600, 1, "SB3 SAC")) == "SB3 SAC: 600 s, 600,000 steps"


@pytest.fixture
def _tiny(monkeypatch) -> None:
    """Make training minimal, and evaluate in this process."""

    def recipe(task: str, algo: str) -> TrainConfig:
        return tiny(algo, Path("unused"), task=task, steps=64, eval_every=64)

    monkeypatch.setattr(benchmark, "recipe", recipe)
    monkeypatch.setattr(evaluate, "usable_cpus", lambda: 1)


@pytest.mark.slow
@pytest.mark.usefixtures("_tiny")
def test_manip_trains_and_is_evaluated_in_stock(tmp_path: Path, capfd) -> None:
    file = tmp_path / "task.json"
    arguments = ("--task", "Reach", "--seeds", "2", "--episodes", "1", "--no-peer")
    assert cli.run(main, [*arguments, "--json", str(file)]) == 0
    record = json.loads(file.read_text())
    assert [result["seed"] for result in record["runs"]] == [0, 1]
    for result in record["runs"]:
        assert result["env_steps"] == 64
        assert result["seconds"] > 0
        assert result["success_held"]["rate"] == 0
    assert record["figures"]["seconds_to_held"] is None
    printed = capfd.readouterr()
    assert "missed" in printed.out
    assert "seed 0 (1 of 2)" in printed.err


def test_a_run_that_fails_is_an_error(monkeypatch, capsys) -> None:
    def recipe(task: str, algo: str) -> TrainConfig:
        return tiny(algo, Path("unused"), task=task, collectors=3)

    monkeypatch.setattr(benchmark, "recipe", recipe)
    assert cli.run(main, ["--task", "Reach", "--no-peer"]) == 2
    assert "num_envs 4 does not split evenly" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--seeds 0", "--seeds must be at least 1, not 0"),
        ("--cap 0", "--cap must be more than 0 minutes, not 0.0"),
        ("--cap inf", "--cap must be more than 0 minutes, not inf"),
        ("--json .", "--json . is a folder"),
        ("--task Lfit --no-peer", "did you mean 'Lift'"),
    ],
)
def test_wrong_options_are_refused(options: str, message: str, capsys) -> None:
    assert cli.run(main, options.split()) == 2
    assert message in capsys.readouterr().err


def test_a_missing_library_is_reported_with_the_command_that_installs_it(
    monkeypatch, capsys
) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.delitem(sys.modules, "manip.benchmarks.task_sb3", raising=False)
    assert cli.run(main, []) == 2
    assert "`make peers` installs" in capsys.readouterr().err


@pytest.fixture
def sb3():
    return pytest.importorskip("manip.benchmarks.task_sb3", exc_type=ImportError)


def test_sb3_gets_manips_observation_and_robosuites_reward(sb3) -> None:
    env = sb3.stock_env("Lift")
    task, batch = load_task("Lift"), env.unwrapped.batch
    env.reset(seed=5)
    for _ in range(2):
        observation, reward, *ends, _ = env.step(env.action_space.sample())
        parts = task.observe(task.measure(batch.read()))
        expected = np.concatenate(list(parts.values()), axis=1, dtype=np.float32)
        np.testing.assert_array_equal(observation, expected[0])
        assert reward == pytest.approx(batch.stock.reward(), abs=1e-6)
        assert ends == [False, False]


def test_a_time_limit_truncates_an_episode_of_sb3(sb3, monkeypatch) -> None:
    monkeypatch.setattr(sb3, "HORIZON", 2)
    env = sb3.stock_env("Reach")
    env.reset()
    action = np.zeros(env.action_space.shape)
    assert [env.step(action)[3] for _ in range(2)] == [False, True]
    env.reset()
    assert not env.step(action)[3]


def test_sb3_stops_at_the_time_limit_without_its_evaluations(
    sb3, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(sb3, "EVALUATIONS", 2)
    monkeypatch.setattr(evaluate, "usable_cpus", lambda: 1)
    monkeypatch.setitem(sb3.OPTIONS, "learning_starts", 25)
    monkeypatch.setitem(sb3.OPTIONS, "buffer_size", 1000)
    result = sb3.learn("Reach", seed=0, limit=4.0, episodes=1)
    assert not result.reached
    assert 4 <= result.seconds < 12
    assert result.env_steps > 25
    assert capsys.readouterr().err.count("success_held   0%") == 2


def test_sb3_stops_at_the_goal(sb3, monkeypatch) -> None:
    monkeypatch.setattr(sb3, "EVALUATIONS", 1000)
    rate = Rate(0.95, 0.8, 1.0)
    monkeypatch.setattr(sb3, "held_in_stock", lambda *_: rate)
    result = sb3.learn("Reach", seed=0, limit=600.0, episodes=1)
    assert result.reached
    assert result.seconds_to_goal == result.seconds < 60
