"""Benchmarks: candidates do the same work, and figures follow from the rounds."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from manip.benchmarks import bench_machines as machines
from manip.benchmarks import bench_returns as returns
from manip.benchmarks import bench_startup as startup
from manip.benchmarks import engine_steps, pendulum, rounds
from manip.benchmarks.rounds import Comparison, Settings, measure
from manip.envs.task import Task
from manip.programs import cli
from manip.programs.benchmark import main
from manip.sim import gl
from manip.sim.bare_physics import bare_physics
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Scene


@pytest.fixture(autouse=True)
def _short_rounds(monkeypatch) -> None:
    monkeypatch.setattr(engine_steps, "STEPS_PER_ROUND", 4)


def test_candidates_are_measured_in_turns_and_ratios_are_within_a_round() -> None:
    turns: list[str] = []
    values = {"a": iter([0, 1.0, 20.0, 3.0]), "b": iter([0, 1.0, 10.0, 1.0])}

    def candidate(name: str):
        def run() -> float:
            turns.append(name)
            return next(values[name])

        return run

    result = measure(
        Comparison(
            "",
            {name: candidate(name) for name in "ab"},
            ratios={"a_vs_b": ("a", "b")},
            medians={"b_alone": "b"},
            facts={"given": 5.0},
        ),
        rounds=3,
    )
    assert turns == list("abababab")
    assert result.rounds == {"a": [1, 20, 3], "b": [1, 10, 1]}
    assert result.figures() == {"a_vs_b": 2.0, "b_alone": 1.0, "given": 5.0}


def test_speed_is_steps_over_time(monkeypatch) -> None:
    clock = iter([10.0, 12.0])
    monkeypatch.setattr(rounds.time, "perf_counter", lambda: next(clock))
    assert rounds.speed(lambda: 50)() == 25.0


@pytest.mark.parametrize("threads", [1, 2])
def test_bare_physics_repeats_the_engine_bit_for_bit(
    threads: int, lift: Task, lift_scene: Scene
) -> None:
    engine = engine_steps.engine_at_start("Lift", lift_scene, 3, threads=1)
    actions = np.random.default_rng(2).uniform(-1, 1, (6, 3, 7))
    run = bare_physics(engine, actions, threads)
    before = engine.read()["qpos"].copy()
    first, again = run().copy(), run().copy()
    for action in actions:
        engine.step(action)
    np.testing.assert_array_equal(first, engine.read()["qpos"])
    np.testing.assert_array_equal(again, first)
    assert np.abs(first - before).max() > 0.01


def test_every_round_starts_from_the_same_state(lift_scene: Scene) -> None:
    engine = engine_steps.engine_at_start("Lift", lift_scene, 2, threads=1)
    run = engine_steps.repeated_steps(engine)
    assert run() == 4
    first = engine.save()
    assert run() == 4
    np.testing.assert_array_equal(engine.states, first.states)


def test_memory_per_environment_is_that_of_one_more(lift_scene: Scene) -> None:
    few, many = (BatchEngine(lift_scene, n, threads=1) for n in (1, 5))
    one, five = few.save(), many.save()
    grown = sum(getattr(five, a).nbytes - getattr(one, a).nbytes for a in ARRAYS)
    assert many.bytes_per_env == few.bytes_per_env == 2 * grown / 4 > 0


ARRAYS = ("states", "readings")


def figures(tmp_path: Path, what: str, *options: str) -> dict[str, float]:
    file = tmp_path / f"{what}.json"
    tiny = ("--num-envs", "2", "--rounds", "1", "--json", str(file))
    assert cli.run(main, [what, *tiny, *options]) == 0
    record = json.loads(file.read_text())
    assert all(isinstance(value, float) for value in record["figures"].values())
    for values in record["candidates"].values():
        assert len(values["rounds"]) == 1
        assert values["minimum"] == values["median"] == values["maximum"] > 0
    return record["figures"]


@pytest.mark.slow
def test_engine_compares_with_bare_physics_and_stock(tmp_path: Path, capsys) -> None:
    values = figures(tmp_path, "engine")
    assert values["exact_1_thread_vs_stock"] > 1
    assert 0.1 < values["exact_vs_bare_1_thread"] < 2
    assert values["memory_per_env_kib"] < 16
    assert "exact vs bare 1 thread" in capsys.readouterr().out


@pytest.mark.slow
def test_env_compares_with_the_engine(tmp_path: Path) -> None:
    values = figures(tmp_path, "env")
    environments = {"env_vs_engine", "gymnasium_vs_engine"}
    assert values.keys() == {*environments, "collect_vs_engine"}


def test_throughput_is_compared_with_the_model() -> None:
    """On-policy in turns, off-policy at once; each round with its own learner."""
    rounds = {
        "ppo, learner alone": [3200.0, 1600.0],
        "sac, learner alone": [320.0, 320],
    }
    for case in machines.CASES:
        rounds |= {case.name(number): [800.0, 1600.0] for number in case.collectors}
    result = machines._against_prediction(rounds)
    assert result["ppo, 1 x 3,200 steps/s, measured / predicted"] == (0.5 + 1.5) / 2
    assert result["sac, 1 x 160 steps/s, measured / predicted"] == (5 + 10) / 2
    assert result["sac, 8 x 160 steps/s, measured / predicted"] == (2.5 + 5) / 2


@pytest.mark.slow
def test_collectors_are_compared_with_rollouts_of_this_process(tmp_path: Path) -> None:
    values = figures(tmp_path, "collectors", "--task", "Reach")
    assert values["copied_vs_here"] > 0
    assert 200 < values["bytes_per_control_step"] < 2000
    assert values["policy_bytes"] > 4 * 128 * 128


@pytest.mark.slow
@pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)
def test_cameras_are_compared_and_drawn(tmp_path: Path) -> None:
    values = figures(tmp_path, "cameras", "--plot", str(tmp_path / "plot.png"))
    assert len(values) == 12
    assert values["robot0_eye_in_hand_64_lean_vs_robosuite"] > 3
    assert values["agentview_64_lean_vs_robosuite"] > 2
    assert (tmp_path / "plot.png").stat().st_size > 10_000


@pytest.mark.slow
def test_scaling_draws_its_plot(tmp_path: Path) -> None:
    values = figures(tmp_path, "scaling", "--plot", str(tmp_path / "plot.png"))
    assert values.keys() == {"most_envs_vs_one", "all_threads_vs_one"}
    assert (tmp_path / "plot.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_cold_start_takes_longer_than_a_warm_one() -> None:
    candidates = startup.comparison(Settings("Reach", num_envs=2)).candidates
    cold, warm = (candidates[f"engine, {kind}"]() for kind in ("cold", "warm"))
    assert cold > warm > candidates["import of the engine"]() > 0


@pytest.mark.slow
def test_a_failed_start_up_reports_the_reason() -> None:
    candidates = startup.comparison(Settings(task="Raech")).candidates
    with pytest.raises(startup.UserError, match="unknown task 'Raech'"):
        candidates["engine, cold"]()


@pytest.mark.parametrize(
    ("what", "library"), [("envpool", "envpool"), ("returns", "stable_baselines3")]
)
def test_a_missing_library_is_reported_with_the_command_that_installs_it(
    what: str, library: str, monkeypatch, capsys
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    assert cli.run(main, [what]) == 2
    assert "make peers" in capsys.readouterr().err


def test_differences_of_returns_have_welchs_interval() -> None:
    """Variances 1 and 1/4 of 3 seeds: 2.94 degrees of freedom, t = 3.2185."""
    rounds = {"manip": [1.0, 2.0, 3.0], "SB3": [0.5, 1.0, 1.5]}
    both = {f"{a}, {w}": rounds[w] for a in ("PPO", "SAC") for w in rounds}
    values = returns.differences(both)
    assert values["SAC_difference"] == pytest.approx(1.0)
    half = 3.2185 * (1.25 / 3) ** 0.5
    assert values["SAC_difference_low"] == pytest.approx(1.0 - half, abs=1e-3)
    assert values["SAC_difference_high"] == pytest.approx(1.0 + half, abs=1e-3)


def test_the_return_without_torque_is_gymnasiums() -> None:
    values = pendulum.mean_return(lambda observation: 0 * observation[:, :1])
    assert -1400 < values < -1000


@pytest.mark.slow
def test_both_libraries_learn_pendulum(monkeypatch) -> None:
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(pendulum, "EPISODES", 20)
    values = measure(returns.comparison(Settings()), rounds=1).rounds
    assert values["SAC, manip"] > [-600]
    assert min(*values["PPO, manip"], *values["PPO, SB3"]) > -800


@pytest.mark.slow
def test_envpool_is_compared(tmp_path: Path) -> None:
    pytest.importorskip("envpool")
    values = figures(tmp_path, "envpool")
    assert values["fast_engine_vs_envpool"] > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("engin", "Expected one of ('engine', 'cameras', 'env'"),
        ("engine --num-envs 0", "--num-envs must be at least 1, not 0"),
        ("engine --task Lfit", "did you mean 'Lift'"),
        ("env --plot x.png", "--plot draws `scaling` and `cameras` only"),
        ("env --json .", "--json . is a folder"),
        ("scaling --plot x.doc", "unknown file format"),
    ],
)
def test_wrong_options_are_refused_before_the_measurement(
    options: str, message: str, capsys
) -> None:
    assert cli.run(main, options.split()) == 2
    assert message in capsys.readouterr().err
