"""Tasks of other libraries: they are the library's own, and work as all others do."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torchrl.envs.utils import check_env_specs

from manip.agents.policy import load_policy
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.external_batch import (
    ExternalBatch,
    external_names,
    load_external,
)
from manip.envs.backends.worker_pool import WorkerPool
from manip.evaluation import runners as evaluation
from manip.programs import cli, main
from manip.robot_config import RobotConfig
from manip.sim.external.dm_control_sim import ROBOT, SOLVED, composer, manipulation
from manip.sim.robosuite_factory import make_stock, reseed
from manip.training.config import recipe
from manip.training.run_logs import read_metrics

Array = np.ndarray

DM, ROBOSUITE = "dm_control/reach_site_features", "robosuite/TwoArmPegInHole"


def opened(name: str, num_envs: int = 2, **options: Any) -> ExternalBatch:
    robot = ROBOT if name.startswith("dm_control") else RobotConfig()
    options = {"threads": 1, "horizon": 6, "robot": robot} | options
    return ExternalBatch(load_external(name), num_envs, **options)


@pytest.fixture(scope="module", params=[DM, ROBOSUITE])
def worlds(request) -> ExternalBatch:
    return opened(request.param)


def actions(worlds: ExternalBatch, steps: int) -> Array:
    shape = steps, worlds.num_envs, worlds.action_dim
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def begun(worlds: ExternalBatch, seed: int) -> ExternalBatch:
    worlds.restart(seed)
    worlds.begin(np.arange(worlds.num_envs))
    return worlds


def observed(worlds: ExternalBatch, moves: Array) -> Array:
    return np.array([worlds.step(move).observation for move in moves])


# They are the library's own


def test_dm_controls_world_is_dm_controls() -> None:
    worlds = begun(opened(DM, 1), 3)
    env = composer.Environment(manipulation.load("reach_site_features").task)
    env.random_state.seed(worlds.episode_seed(0))
    shown, spec = env.reset().observation, env.action_spec()
    assert worlds.layout.keys() == shown.keys()
    for move in actions(worlds, 5):
        step, time_step = (
            env.step(move[0].astype(float) * spec.maximum),
            worlds.step(move),
        )
        for name, part in worlds.layout.items():
            expected = step.observation[name].ravel().astype(np.float32)
            np.testing.assert_allclose(
                time_step.observation[0, part], expected, rtol=1e-4, atol=1e-6
            )
        assert time_step.reward == pytest.approx(step.reward)
        assert time_step.success == (step.reward >= SOLVED)


def test_robosuites_world_is_robosuites() -> None:
    worlds = begun(opened(ROBOSUITE, 1), 3)
    env = make_stock("TwoArmPegInHole", seed=0)
    assert len(env.robots) == 2
    reseed(env, worlds.episode_seed(0))
    env.reset()
    for move in actions(worlds, 5):
        shown, reward, _, _ = env.step(move[0].astype(float))
        time_step = worlds.step(move)
        for name, part in worlds.layout.items():
            expected = np.ravel(shown[name]).astype(np.float32)
            np.testing.assert_array_equal(time_step.observation[0, part], expected)
        assert (time_step.reward, time_step.success) == (reward, env._check_success())
    assert {"robot1_eef_pos", "peg_to_hole"} <= worlds.layout.keys()
    assert not [name for name in worlds.layout if "acc" in name]


@pytest.mark.slow
@pytest.mark.parametrize("name", external_names())
def test_every_task_runs(name: str) -> None:
    worlds = opened(name, 1)
    check_env_specs(TaskEnv(worlds))
    first = observed(begun(worlds, 1), actions(worlds, 4))
    assert np.isfinite(first).all()
    np.testing.assert_array_equal(observed(begun(worlds, 1), actions(worlds, 4)), first)


# They work as all others do


def test_an_episode_runs_to_its_time_limit_and_is_repeated(worlds) -> None:
    check_env_specs(TaskEnv(worlds))
    begun(worlds, 7)
    found = [worlds.step(move) for move in actions(worlds, 6)]
    ends = [time_step.truncated.tolist() for time_step in found]
    assert ends == 5 * [[False] * 2] + [[True] * 2]
    assert not np.any([time_step.terminated for time_step in found])
    first = np.array([time_step.observation for time_step in found])
    np.testing.assert_array_equal(observed(begun(worlds, 7), actions(worlds, 6)), first)
    assert not np.allclose(observed(begun(worlds, 8), actions(worlds, 6)), first)
    assert not np.allclose(first[:, 0], first[:, 1])


def test_a_broken_world_is_cut_off(worlds: ExternalBatch) -> None:
    before = begun(worlds, 0).observe().observation
    count = worlds.fault_count
    move = actions(worlds, 1)[0]
    move[1, 0] = np.nan
    time_step = worlds.step(move)
    assert time_step.truncated.tolist() == [False, True]
    assert worlds.fault_count == count + 1
    np.testing.assert_array_equal(time_step.observation[1], before[1])
    assert not np.allclose(time_step.observation[0], before[0])
    worlds.begin(np.array([1]))
    assert not worlds.step(actions(worlds, 1)[0]).truncated.any()


def test_saved_worlds_go_on_where_they_were(worlds: ExternalBatch) -> None:
    moves = actions(worlds, 6)
    observed(begun(worlds, 2), moves[:4])
    worlds.begin(np.array([1]))  # saved with no action yet
    saved, shown = worlds.save_state(), worlds.observe().observation
    rest = observed(worlds, moves[4:])
    begun(worlds, 2)
    worlds.load_state(saved)
    np.testing.assert_array_equal(worlds.observe().observation, shown)
    np.testing.assert_array_equal(observed(worlds, moves[4:]), rest)
    assert worlds.elapsed.tolist() == [6, 2]


@pytest.mark.slow
@pytest.mark.parametrize("name", [DM, ROBOSUITE])
def test_episodes_do_not_depend_on_worlds_and_processes(name: str) -> None:
    few, many = opened(name, 2), opened(name, 3, threads=2)
    moves = actions(many, 4)
    expected = observed(begun(few, 1), moves[:, :2])
    np.testing.assert_array_equal(observed(begun(many, 1), moves)[:, :2], expected)


def test_success_of_dm_control_is_a_full_reward_and_divergence_breaks() -> None:
    worlds = begun(opened(DM, 3, stagger=True), 0)
    assert worlds.elapsed.tolist() == [0, 2, 4]
    world = worlds._crew._here[0]
    for reward in (0.0, 0.9, 1.0):
        world._env.task.get_reward = lambda physics, reward=reward: reward
        assert worlds.step(np.zeros((3, 9))).success[0] == (reward == 1)
    world._env.physics.data.qvel[0] = np.nan
    assert worlds.step(np.zeros((3, 9))).truncated[0]
    assert worlds.fault_count == 1


def test_a_process_that_died_is_told() -> None:
    crew = WorkerPool(str, 2, 2)
    asked = {0: (3,), 1: (3,)}
    assert crew.ask("zfill", asked) == {0: "000", 1: "001"}
    (process,) = crew._home[1]._processes.values()
    process.kill()
    with pytest.raises(ChildProcessError, match="a process that steps worlds has died"):
        crew.ask("zfill", asked)


# Programs


TINY = [
    *("--algo", "ppo", "--steps", "64", "--num-envs", "2", "--threads", "1"),
    *("--eval-every", "64", "--eval-episodes", "1", "--agent.rollout-length", "16"),
    *("--agent.actor-hidden", "8", "--agent.critic-hidden", "8", "--horizon", "20"),
]


def start(program: str, *arguments: object) -> int:
    return cli.run(main._program(program), list(map(str, arguments)))


@pytest.mark.slow
@pytest.mark.parametrize("task", [DM, "robosuite/TwoArmLift"])
def test_it_is_trained_and_judged(task, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(evaluation, "usable_cpus", lambda: 1)
    run, result = tmp_path / "run", tmp_path / "eval.json"
    assert start("train", "--task", task, *TINY, "--out", run) == 0
    library = task.split("/")[0]
    assert f"{task} is stepped by {library} itself" in capsys.readouterr().err
    card = load_policy(run).card
    assert card.task == task
    assert start("evaluate", run, "--episodes", 1, "--json", result) == 0
    assert f"stock {library}" in " ".join(capsys.readouterr().out.split())
    assert json.loads(result.read_text())["milestones"].keys() == {"success"}
    for command in (("evaluate", run, "--env", "native"), ("render", run)):
        assert start(*command) == 2
        assert "is not on the batch engine" in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_goes_on_bit_for_bit(tmp_path: Path) -> None:
    rows = []
    for halves in ((64, 128), (128,)):
        run, more = tmp_path / str(len(halves)), ()
        for steps in halves:
            options = ("--task", DM, *TINY, "--steps", steps, "--out", run, *more)
            assert start("train", *options) == 0
            more = ("--resume",)
        rows.append(read_metrics(run / "metrics.csv"))
        assert len(rows[-1]) == 2
    clocks = {"seconds", "cpu_seconds", "steps_per_second"}
    whole, resumed = ([{k: r[k] for k in r.keys() - clocks} for r in of] for of in rows)
    assert whole == resumed


DM_TASK, OWN = f"--task {DM}", "it needs fidelity exact and restart_fraction 0, not "


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("--task robosuit/Lift", "unknown library 'robosuit': did you mean 'robosuite"),
        ("--task robosuite/TwoArmLft", "unknown robosuite task 'TwoArmLft': did you"),
        ("--task dm_control/reach", "unknown dm_control task 'reach': "),
        (f"{DM_TASK} --robot Panda", "unknown robot 'Panda': known robots: Jaco"),
        (f"{DM_TASK} --controller OSC_POSE", "known controllers: JOINT_VELOCITY"),
        (f"{DM_TASK} --control-freq 20", "known control_freqs: 25"),
        (f"{DM_TASK} --fidelity fast", OWN + "fast and 0.0"),
        (f"{DM_TASK} --restart-fraction 0.5", OWN + "exact and 0.5"),
        (f"{DM_TASK} --reward shaped", "known rewards: stock"),
        ("--task robosuite/Lift --controller JOINT_VELOCITY", "unknown controller"),
        ("--task Lift --controller JOINT_VELOCITY", "unknown controller"),
    ],
)
def test_mistakes_are_one_line(options: str, told: str, tmp_path: Path, capsys) -> None:
    arguments = (*options.split(), "--threads", 1, "--out", tmp_path / "run")
    assert start("train", *arguments) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert told in line
    assert not list(tmp_path.iterdir())


def test_tasks_of_a_library_share_its_recipe() -> None:
    found = recipe("dm_control/lift_brick_features", "sac")
    assert (found.robot, found.controller, found.control_freq) == ROBOT
    assert (found.fidelity, found.reward, found.horizon) == ("exact", "stock", 250)
    assert found.folder == Path("runs/dm_control-lift_brick_features-sac-0")
    assert recipe("robosuite/Door", "ppo").horizon == 500
