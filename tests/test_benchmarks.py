"""Benchmarks: what is compared is alike, and figures are what the rounds say."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from manip.benchmarks import bench_returns as returns
from manip.benchmarks import bench_startup as startup
from manip.benchmarks import contest
from manip.benchmarks import task_envs as worlds
from manip.benchmarks.contest import Contest, Settings, hold
from manip.envs.task import Task
from manip.programs import cli
from manip.programs.benchmark import main
from manip.sim.bare_physics import bare_physics
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Scene


@pytest.fixture(autouse=True)
def _short_rounds(monkeypatch) -> None:
    monkeypatch.setattr(worlds, "STEPS_A_ROUND", 4)


def test_contestants_take_turns_and_ratios_are_of_the_same_round() -> None:
    turns: list[str] = []
    values = {"a": iter([0, 1.0, 20.0, 3.0]), "b": iter([0, 1.0, 10.0, 1.0])}

    def contestant(name: str):
        def go() -> float:
            turns.append(name)
            return next(values[name])

        return go

    found = hold(
        Contest(
            "",
            {name: contestant(name) for name in "ab"},
            ratios={"a_vs_b": ("a", "b")},
            medians={"b_alone": "b"},
            facts={"given": 5.0},
        ),
        rounds=3,
    )
    assert turns == list("abababab")
    assert found.rounds == {"a": [1, 20, 3], "b": [1, 10, 1]}
    assert found.figures() == {"a_vs_b": 2.0, "b_alone": 1.0, "given": 5.0}


def test_speed_is_steps_over_time(monkeypatch) -> None:
    clock = iter([10.0, 12.0])
    monkeypatch.setattr(contest.time, "perf_counter", lambda: next(clock))
    assert contest.speed(lambda: 50)() == 25.0


@pytest.mark.parametrize("threads", [1, 2])
def test_bare_physics_repeats_the_engine_bit_for_bit(
    threads: int, lift: Task, lift_scene: Scene
) -> None:
    engine = worlds.started("Lift", lift_scene, 3, threads=1)
    actions = np.random.default_rng(2).uniform(-1, 1, (6, 3, 7))
    run = bare_physics(engine, actions, threads)
    before = engine.read()["qpos"].copy()
    first, again = run().copy(), run().copy()
    for action in actions:
        engine.step(action)
    np.testing.assert_array_equal(first, engine.read()["qpos"])
    np.testing.assert_array_equal(again, first)
    assert np.abs(first - before).max() > 0.01


def test_a_round_starts_where_the_last_one_did(lift_scene: Scene) -> None:
    engine = worlds.started("Lift", lift_scene, 2, threads=1)
    go = worlds.repeats(engine)
    assert go() == 4
    first = engine.save()
    assert go() == 4
    np.testing.assert_array_equal(engine.states, first.states)


def test_memory_of_a_world_is_what_one_more_takes(lift_scene: Scene) -> None:
    few, many = (BatchEngine(lift_scene, n, threads=1) for n in (1, 5))
    one, five = few.save(), many.save()
    grown = sum(getattr(five, a).nbytes - getattr(one, a).nbytes for a in ARRAYS)
    assert many.bytes_per_env == few.bytes_per_env == 2 * grown / 4 > 0


ARRAYS = ("states", "readings")


def figures(tmp_path: Path, what: str, *options: str) -> dict[str, float]:
    file = tmp_path / f"{what}.json"
    tiny = ("--worlds", "2", "--rounds", "1", "--json", str(file))
    assert cli.run(main, [what, *tiny, *options]) == 0
    record = json.loads(file.read_text())
    assert all(isinstance(value, float) for value in record["figures"].values())
    for found in record["contestants"].values():
        assert len(found["rounds"]) == 1
        assert found["lowest"] == found["median"] == found["highest"] > 0
    return record["figures"]


@pytest.mark.slow
def test_engine_compares_with_bare_physics_and_stock(tmp_path: Path, capsys) -> None:
    found = figures(tmp_path, "engine")
    assert found["exact_1_thread_vs_stock"] > 1
    assert 0.1 < found["exact_vs_bare_1_thread"] < 2
    assert found["memory_per_world_kib"] < 16
    assert "exact vs bare 1 thread" in capsys.readouterr().out


@pytest.mark.slow
def test_env_compares_with_the_engine(tmp_path: Path) -> None:
    found = figures(tmp_path, "env")
    environments = {"env_vs_engine", "gymnasium_vs_engine"}
    assert found.keys() == {*environments, "collect_vs_engine"}


@pytest.mark.slow
def test_scaling_draws_its_plot(tmp_path: Path) -> None:
    found = figures(tmp_path, "scaling", "--plot", str(tmp_path / "plot.png"))
    assert found.keys() == {"most_worlds_vs_one", "all_threads_vs_one"}
    assert (tmp_path / "plot.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_cold_start_takes_longer_than_a_warm_one() -> None:
    begun = startup.contest(Settings("Reach", worlds=2)).contestants
    cold, warm = (begun[f"engine, {kind}"]() for kind in ("cold", "warm"))
    assert cold > warm > begun["import of the engine"]() > 0


def test_a_start_that_fails_says_why() -> None:
    begun = startup.contest(Settings(task="Raech"))
    with pytest.raises(startup.UserError, match="unknown task 'Raech'"):
        begun.contestants["engine, cold"]()


@pytest.mark.parametrize(
    ("what", "library"), [("envpool", "envpool"), ("returns", "stable_baselines3")]
)
def test_without_the_extra_a_benchmark_says_what_to_install(
    what: str, library: str, monkeypatch, capsys
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    assert cli.run(main, [what]) == 2
    assert "make peers" in capsys.readouterr().err


def test_differences_of_returns_have_welchs_interval() -> None:
    """Variances 1 and 1/4 of 3 seeds: 2.94 degrees of freedom, t = 3.2185."""
    rounds = {"manip": [1.0, 2.0, 3.0], "SB3": [0.5, 1.0, 1.5]}
    both = {f"{a}, {w}": rounds[w] for a in ("PPO", "SAC") for w in rounds}
    found = returns.differences(both)
    assert found["SAC_difference"] == pytest.approx(1.0)
    half = 3.2185 * (1.25 / 3) ** 0.5
    assert found["SAC_difference_low"] == pytest.approx(1.0 - half, abs=1e-3)
    assert found["SAC_difference_high"] == pytest.approx(1.0 + half, abs=1e-3)


def test_a_torque_of_nothing_swings_as_gymnasium_has_it() -> None:
    found = returns.mean_return(lambda observation: 0 * observation[:, :1])
    assert -1400 < found < -1000


@pytest.mark.slow
def test_both_learners_of_returns_learn(monkeypatch) -> None:
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(returns, "EPISODES", 20)
    found = hold(returns.contest(Settings()), rounds=1).rounds
    assert found["SAC, manip"] > [-600]
    assert min(*found["PPO, manip"], *found["PPO, SB3"]) > -800


@pytest.mark.slow
def test_the_neighbour_runs_at_our_control_rate(tmp_path: Path) -> None:
    pytest.importorskip("envpool")
    found = figures(tmp_path, "envpool")
    assert found["fast_engine_vs_envpool"] > 0


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("engin", "Expected one of ('engine', 'env', 'startup'"),
        ("engine --worlds 0", "--worlds must be at least 1, not 0"),
        ("engine --task Lfit", "did you mean 'Lift'"),
        ("env --plot x.png", "--plot draws `scaling` only"),
    ],
)
def test_mistakes_are_told(options: str, told: str, capsys) -> None:
    assert cli.run(main, options.split()) == 2
    assert told in capsys.readouterr().err
