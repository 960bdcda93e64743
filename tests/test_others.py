"""Tasks of other libraries: equal to the library's own, and used like all others."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torchrl.envs.utils import check_env_specs

from manip.agents.policy import load_policy
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.external_batch import ExternalBatch
from manip.envs.backends.worker_pool import WorkerPool
from manip.envs.episode_streams import TRAINING, build_seed
from manip.envs.external_task import external_names, load_external
from manip.errors import UserError
from manip.evaluation import runners as evaluation
from manip.programs import cli, main
from manip.robot_config import RobotConfig
from manip.sim.external.dm_control_sim import ROBOT, SOLVED, composer, manipulation
from manip.sim.robosuite_factory import make_stock, reseed
from manip.training.recipes import recipe
from manip.training.run_logs import read_metrics

Array = np.ndarray

DM, ROBOSUITE = "dm_control/reach_site_features", "robosuite/TwoArmPegInHole"


def opened(name: str, num_envs: int = 2, **options: Any) -> ExternalBatch:
    robot = ROBOT if name.startswith("dm_control") else RobotConfig()
    options = {"threads": 1, "horizon": 6, "robot": robot} | options
    return ExternalBatch(load_external(name), num_envs, **options)


@pytest.fixture(scope="module", params=[DM, ROBOSUITE])
def batch(request) -> ExternalBatch:
    return opened(request.param)


def actions(batch: ExternalBatch, steps: int) -> Array:
    shape = steps, batch.num_envs, batch.action_dim
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def begun(batch: ExternalBatch, seed: int) -> ExternalBatch:
    batch.restart(seed)
    batch.begin(np.arange(batch.num_envs))
    return batch


def observed(batch: ExternalBatch, moves: Array) -> Array:
    return np.array([batch.step(move).observation for move in moves])


# Equal to the library's own


def test_a_dm_control_task_is_dm_controls() -> None:
    batch = begun(opened(DM, 1), 3)
    env = composer.Environment(manipulation.load("reach_site_features").task)
    env.random_state.seed(batch.episode_seed(0))
    shown, spec = env.reset().observation, env.action_spec()
    assert list(batch.observation_spec.names) == list(shown)
    for move in actions(batch, 5):
        step = env.step(move[0].astype(float) * spec.maximum)
        time_step = batch.step(move)
        parts = batch.observation_spec.split(time_step.observation[0])
        for name, part in parts.items():
            expected = step.observation[name].ravel().astype(np.float32)
            np.testing.assert_allclose(part, expected, rtol=1e-4, atol=1e-6)
        assert time_step.reward == pytest.approx(step.reward)
        assert time_step.success == (step.reward >= SOLVED)


def test_a_robosuite_task_is_robosuites() -> None:
    batch = begun(opened(ROBOSUITE, 1), 3)
    env = make_stock("TwoArmPegInHole", seed=build_seed(0, TRAINING, 0))
    assert len(env.robots) == 2
    reseed(env, batch.episode_seed(0))
    env.reset()
    for move in actions(batch, 5):
        shown, reward, _, _ = env.step(move[0].astype(float))
        time_step = batch.step(move)
        parts = batch.observation_spec.split(time_step.observation[0])
        for name, part in parts.items():
            expected = np.ravel(shown[name]).astype(np.float32)
            np.testing.assert_array_equal(part, expected)
        assert (time_step.reward, time_step.success) == (reward, env._check_success())
    assert {"robot1_eef_pos", "peg_to_hole"} <= parts.keys()
    assert not [name for name in parts if "acc" in name]


def test_roles_tell_the_arms_from_the_objects(batch: ExternalBatch) -> None:
    arm = "jaco_arm/" if batch.task.library == "dm_control" else "robot"
    for part in batch.observation_spec.parts:
        assert (part.role == "proprioception") == part.name.startswith(arm), part


@pytest.mark.slow
@pytest.mark.parametrize("name", external_names())
def test_every_task_runs(name: str) -> None:
    batch = opened(name, 1)
    check_env_specs(TaskEnv(batch))
    first = observed(begun(batch, 1), actions(batch, 4))
    assert np.isfinite(first).all()
    np.testing.assert_array_equal(observed(begun(batch, 1), actions(batch, 4)), first)


# Used like all others


def test_an_episode_runs_to_its_time_limit_and_is_repeated(batch) -> None:
    check_env_specs(TaskEnv(batch))
    begun(batch, 7)
    steps = [batch.step(move) for move in actions(batch, 6)]
    ends = [time_step.truncated.tolist() for time_step in steps]
    assert ends == 5 * [[False] * 2] + [[True] * 2]
    assert not np.any([time_step.terminated for time_step in steps])
    first = np.array([time_step.observation for time_step in steps])
    np.testing.assert_array_equal(observed(begun(batch, 7), actions(batch, 6)), first)
    assert not np.allclose(observed(begun(batch, 8), actions(batch, 6)), first)
    assert not np.allclose(first[:, 0], first[:, 1])


def test_no_two_episodes_of_small_seeds_are_the_same(batch: ExternalBatch) -> None:
    seeds = []
    for seed in range(3):
        batch.restart(seed)
        for _ in range(3):
            batch.episode += 1
            seeds += [batch.episode_seed(env_id) for env_id in range(2)]
    assert len(set(seeds)) == 18


def test_a_diverged_environment_is_cut_off(batch: ExternalBatch) -> None:
    before = begun(batch, 0).observe().observation
    count = batch.fault_count
    move = actions(batch, 1)[0]
    move[1, 0] = np.nan
    time_step = batch.step(move)
    assert time_step.truncated.tolist() == [False, True]
    assert batch.fault_count == count + 1
    np.testing.assert_array_equal(time_step.observation[1], before[1])
    assert not np.allclose(time_step.observation[0], before[0])
    batch.begin(np.array([1]))
    assert not batch.step(actions(batch, 1)[0]).truncated.any()


@pytest.mark.parametrize("action", [np.zeros((2, 3)), np.zeros(2), [["up"], ["up"]]])
def test_an_action_of_another_shape_or_kind_is_refused(action, batch) -> None:
    begun(batch, 0)
    with pytest.raises(UserError, match="the action"):
        batch.step(action)


def test_a_step_before_the_first_reset_is_refused(batch: ExternalBatch) -> None:
    batch.restart(0)
    with pytest.raises(UserError, match=r"step\(\) was called before reset\(\)"):
        batch.step(actions(batch, 1)[0])


def test_a_saved_state_continues_where_it_was(batch: ExternalBatch) -> None:
    moves = actions(batch, 6)
    observed(begun(batch, 2), moves[:4])
    batch.begin(np.array([1]))  # saved with no action yet
    saved, shown = batch.save_state(), batch.observe().observation
    rest = observed(batch, moves[4:])
    begun(batch, 2)
    batch.load_state(saved)
    np.testing.assert_array_equal(batch.observe().observation, shown)
    np.testing.assert_array_equal(observed(batch, moves[4:]), rest)
    assert batch.elapsed.tolist() == [6, 2]


@pytest.mark.parametrize(
    "change",
    [
        {"actions": [np.zeros((0, 2))] * 2},
        {"actions": [np.zeros((0, 2))]},
        {"elapsed": np.zeros(1, np.int64)},
        {"episode": np.array([0.0, 0.0])},
        {"fault_count": -1},
    ],
    ids=str,
)
def test_a_saved_state_of_other_environments_is_refused(change, batch) -> None:
    saved = begun(batch, 2).save_state()
    with pytest.raises(UserError):
        batch.load_state(saved | change)


@pytest.mark.slow
@pytest.mark.parametrize("name", [DM, ROBOSUITE])
def test_episodes_do_not_depend_on_num_envs_and_processes(name: str) -> None:
    few, many = opened(name, 2), opened(name, 3, threads=2)
    moves = actions(many, 4)
    expected = observed(begun(few, 1), moves[:, :2])
    np.testing.assert_array_equal(observed(begun(many, 1), moves)[:, :2], expected)


def test_success_of_dm_control_is_a_full_reward_and_divergence_truncates() -> None:
    batch = begun(opened(DM, 3, stagger=True), 0)
    assert batch.elapsed.tolist() == [0, 2, 4]
    simulation = batch._pool._local[0]
    for reward in (0.0, 0.9, 1.0):
        simulation._env.task.get_reward = lambda physics, reward=reward: reward
        assert batch.step(np.zeros((3, 9))).success[0] == (reward == 1)
    simulation._env.physics.data.qvel[0] = np.nan
    assert batch.step(np.zeros((3, 9))).truncated[0]
    assert batch.fault_count == 1


def test_a_worker_that_died_is_an_error() -> None:
    pool = WorkerPool(str, 2, 2)
    arguments = {0: (3,), 1: (3,)}
    assert pool.call("zfill", arguments) == {0: "000", 1: "001"}
    (process,) = pool._workers[1]._processes.values()
    process.kill()
    with pytest.raises(ChildProcessError, match="a worker process has died"):
        pool.call("zfill", arguments)


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_workers_end_with_their_parent(number: signal.Signals, tmp_path: Path) -> None:
    """Even if it is killed: each holds hundreds of megabytes."""
    (tmp_path / "program.py").write_text(
        """
import time
from manip.envs.backends.worker_pool import WorkerPool
if __name__ == "__main__":
    pool = WorkerPool(str, 2, 2)
    pool.call("zfill", {0: (3,), 1: (3,)})
    workers = {w: None for w in pool._workers.values()}
    print(*(pid for worker in workers for pid in worker._processes), flush=True)
    time.sleep(60)
"""
    )
    command = [sys.executable, str(tmp_path / "program.py")]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    workers = [int(pid) for pid in parent.stdout.readline().split()]
    assert len(workers) == 2
    parent.send_signal(number)
    parent.wait(10)
    deadline = time.monotonic() + 10
    while any(map(is_running, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_running, workers))


def is_running(pid: int) -> bool:
    """A process that has ended may still be listed until its parent collects it."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


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
def test_it_is_trained_and_evaluated(task, tmp_path: Path, monkeypatch, capsys) -> None:
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
        table = read_metrics(run / "metrics.csv")
        rows.append([row for row in table if row["eval/return"]])
        assert len(rows[-1]) == 2
    clocks = {"seconds", "cpu_seconds", "steps_per_second"}
    compared = [k for k in rows[0][0] if k not in clocks and "curve/" not in k]
    whole, resumed = ([{k: r[k] for k in compared} for r in of] for of in rows)
    assert whole == resumed


DM_TASK, OWN = f"--task {DM}", "it needs fidelity exact and restart_fraction 0, not "


@pytest.mark.parametrize(
    ("options", "message"),
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
def test_mistakes_are_one_line(
    options: str, message: str, tmp_path: Path, capsys
) -> None:
    arguments = (*options.split(), "--threads", 1, "--out", tmp_path / "run")
    assert start("train", *arguments) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert message in line
    assert not list(tmp_path.iterdir())


def test_tasks_of_a_library_share_its_recipe() -> None:
    config = recipe("dm_control/lift_brick_features", "sac")
    assert (config.robot, config.controller, config.control_freq) == ROBOT
    assert (config.fidelity, config.reward, config.horizon) == ("exact", "stock", 250)
    assert config.folder == Path("runs/dm_control-lift_brick_features-sac-0")
    assert recipe("robosuite/Door", "ppo").horizon == 500
