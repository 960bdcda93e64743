"""The benchmark of whole tasks: honest medians, real processes, real robosuite."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from manip.benchmarks import bench_task as benchmark
from manip.benchmarks.attempts import Attempt, figures, median_time, verdict
from manip.envs.task_registry import load_task
from manip.evaluation import runners as evaluate
from manip.evaluation.statistics import Rate
from manip.programs import cli
from manip.programs.benchmark_task import main


def attempt(seconds: float, rate: float, who: str = "manip SAC") -> Attempt:
    return Attempt(who, 0, seconds, int(1000 * seconds), Rate(rate, 0.0, 1.0))


def test_a_seed_that_misses_the_goal_takes_for_ever() -> None:
    assert median_time([attempt(10, 1), attempt(1, 0.94), attempt(20, 0.95)]) == 20
    assert median_time([attempt(1, 0.9), attempt(1, 0.9), attempt(2, 1)]) == float(
        "inf"
    )


def test_figures_tell_failures_from_times() -> None:
    found = figures([attempt(10, 1.0), attempt(30, 1.0)], [attempt(600, 0.2, "SB3")])
    assert found["seconds_to_held"] == 20
    assert found["env_steps_to_held"] == 20_000
    assert found["sb3_seconds_to_held"] is None
    assert found["sb3_times_longer_at_least"] == 30
    missed = figures([attempt(10, 0.5)], [])
    assert missed["seconds_to_held"] is None
    assert (missed["seeds_reached"], missed["seeds"]) == (0, 1)
    json.dumps([found, missed], allow_nan=False)


def test_a_peer_is_told_of_in_a_line() -> None:
    late = verdict(attempt(600, 0.25, "SB3 SAC"))
    assert late == "SB3 SAC: not within 10 min: 25% held after 600,000 steps"
    assert verdict(attempt(600, 1, "SB3 SAC")) == "SB3 SAC: 600 s, 600,000 steps"


@pytest.fixture
def _tiny(monkeypatch) -> None:
    """Training that learns nothing, and judges in this process."""
    train = benchmark._train
    size = ("--num-envs", "4", "--threads", "1", "--agent.batch-size", "16")
    less = ("--steps", "64", "--eval-every", "64", "--eval-episodes", "1", *size)
    monkeypatch.setattr(
        benchmark, "_train", lambda t, s, to, more=(): train(t, s, to, (*less, *more))
    )
    monkeypatch.setattr(evaluate, "usable_cpus", lambda: 1)


@pytest.mark.usefixtures("_tiny")
def test_ours_is_a_process_that_trains_and_is_judged_in_stock(
    tmp_path: Path, capfd
) -> None:
    file = tmp_path / "task.json"
    asked = ("--task", "Reach", "--seeds", "1", "--episodes", "1", "--no-peer")
    assert cli.run(main, [*asked, "--json", str(file)]) == 0
    record = json.loads(file.read_text())
    (found,) = record["attempts"]
    assert found["env_steps"] == 64
    assert found["seconds"] > 1
    assert found["success_held"]["rate"] == 0
    assert record["figures"]["seconds_to_held"] is None
    said = capfd.readouterr()
    assert "missed" in said.out
    assert "seed 0 (1 of 1)" in said.err


def test_training_that_fails_is_told(tmp_path: Path, capfd) -> None:
    with pytest.raises(benchmark.UserError, match="training Lift with seed 0 failed"):
        benchmark._train("Lift", 0, tmp_path, ("--steps", "0"))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("--seeds 0", "--seeds must be at least 1, not 0"),
        ("--cap 0", "--cap must be more than 0 minutes, not 0.0"),
        ("--task Lfit --no-peer", "did you mean 'Lift'"),
    ],
)
def test_mistakes_are_told(options: str, told: str, capsys) -> None:
    assert cli.run(main, options.split()) == 2
    assert told in capsys.readouterr().err


def test_without_the_extra_it_says_what_to_install(monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.delitem(sys.modules, "manip.benchmarks.task_sb3", raising=False)
    assert cli.run(main, []) == 2
    assert "`make peers` installs" in capsys.readouterr().err


@pytest.fixture
def sb3():
    return pytest.importorskip("manip.benchmarks.task_sb3", exc_type=ImportError)


def test_the_peer_sees_what_our_tasks_see_and_robosuite_pays(sb3) -> None:
    peer = sb3.stock_env("Lift")
    task, worlds = load_task("Lift"), peer.unwrapped.batch
    peer.reset(seed=5)
    for _ in range(2):
        seen, reward, *ends, _ = peer.step(peer.action_space.sample())
        parts = task.observe(task.measure(worlds.read()))
        expected = np.concatenate(list(parts.values()), axis=1, dtype=np.float32)
        np.testing.assert_array_equal(seen, expected[0])
        assert reward == pytest.approx(worlds.stock.reward(), abs=1e-6)
        assert ends == [False, False]


def test_a_time_limit_truncates_the_peer(sb3, monkeypatch) -> None:
    monkeypatch.setattr(sb3, "HORIZON", 2)
    peer = sb3.stock_env("Reach")
    peer.reset()
    action = np.zeros(peer.action_space.shape)
    assert [peer.step(action)[3] for _ in range(2)] == [False, True]
    peer.reset()
    assert not peer.step(action)[3]


def test_the_peer_stops_at_the_cap_with_the_clock_of_its_learning(
    sb3, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(sb3, "EVALUATIONS", 2)
    monkeypatch.setattr(evaluate, "usable_cpus", lambda: 1)
    monkeypatch.setitem(sb3.OPTIONS, "learning_starts", 25)
    monkeypatch.setitem(sb3.OPTIONS, "buffer_size", 1000)
    found = sb3.learn("Reach", seed=0, cap=4.0, episodes=1)
    assert not found.reached
    assert 4 <= found.seconds < 12
    assert found.env_steps > 25
    assert capsys.readouterr().err.count("held   0%") == 2


def test_the_peer_stops_at_the_goal(sb3, monkeypatch) -> None:
    monkeypatch.setattr(sb3, "EVALUATIONS", 1000)
    held = Rate(0.95, 0.8, 1.0)
    monkeypatch.setattr(sb3, "held_in_stock", lambda *_: held)
    found = sb3.learn("Reach", seed=0, cap=600.0, episodes=1)
    assert found.reached
    assert found.time == found.seconds < 60
