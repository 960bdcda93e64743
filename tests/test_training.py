"""Training runs: what they leave behind, that they repeat themselves, and resume."""

import errno
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from sameness import assert_same
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from manip.agents.policy import load_policy
from manip.envs.backends import native_batch as native
from manip.envs.task_registry import load_task, task_names
from manip.errors import UserError
from manip.io.tensor_trees import load_tree, save_tree
from manip.programs import cli, train
from manip.sim.scene import Scene, load_scene
from manip.sim.sensors import Sensors
from manip.training.build import policy_of
from manip.training.config import (
    ALGORITHMS,
    TrainConfig,
    from_dict,
    recipe,
    recipe_names,
    recipes,
    to_dict,
)
from manip.rewards.reward_function import EnvironmentReward
from manip.training.lifecycle import SignalHandler
from manip.training.run_logs import MetricsTable, read_metrics
from manip.training.terminal import TerminalProgress
from manip.training.trainer import Trainer

AGENTS = {
    "bc": {"rollout_length": 8, "batch_size": 32, "buffer_size": 160},
    "reinforce": {"critic_hidden": [16], "rollout_length": 16},
    "a2c": {"critic_hidden": [16], "rollout_length": 8},
    "a3c": {"critic_hidden": [16], "rollout_length": 8, "workers": 2},
    "trpo": {"critic_hidden": [16], "rollout_length": 16, "minibatches": 2},
    "ppo-kl": {"critic_hidden": [16], "rollout_length": 16, "minibatches": 2},
    "td3": {"random_steps": 128, "buffer_size": 160, "batch_size": 32},
    "dqn": {"random_steps": 128, "buffer_size": 160, "batch_size": 32},
    "ppo": {
        "critic_hidden": [16],
        "rollout_length": 16,
        "minibatches": 2,
        "epochs": 2,
    },
    # The buffer is filled three times over; not every round updates the actor.
    "sac": {
        "critic_hidden": [16],
        "random_steps": 128,
        "buffer_size": 160,
        "batch_size": 32,
        "actor_delay": 20,
    },
}
OFTEN = ("bc", "ppo", "sac")
"""Algorithms that the fast tests run; the slow ones run the others."""
ROLLOUT = {
    algo: 4 * options.get("rollout_length", 8) for algo, options in AGENTS.items()
}
"""Control steps between two updates."""
ROLLOUT["a3c"] //= 2
TIMES = ("seconds", "cpu_seconds", "steps_per_second")
"""Columns that depend on the clock."""

by_algorithm = pytest.mark.parametrize(
    "algo",
    [
        algo if algo in OFTEN else pytest.param(algo, marks=pytest.mark.slow)
        for algo in sorted(AGENTS)
    ],
)


def tiny(algo: str, out: Path, **changes: Any) -> TrainConfig:
    hidden = "critic_hidden" if algo == "dqn" else "actor_hidden"
    agent = {hidden: [16]} | AGENTS[algo]
    options = {
        "task": "Reach",
        "algo": algo,
        "out": str(out),
        "steps": 512,
        "num_envs": 4,
        "threads": 2,
        "horizon": 20,
        "eval_every": 192,
        "eval_episodes": 2,
        "agent": agent | changes.pop("agent", {}),
    }
    return from_dict(options | changes)


def new_trainer(config: TrainConfig) -> Trainer:
    return Trainer(config, TerminalProgress(), EnvironmentReward(), Event())


@pytest.fixture(scope="module", autouse=True)
def _shared_scenes() -> Iterator[None]:
    """Runs of the same rig share its compiled scene: building one takes longest."""
    scenes: dict[Any, Scene] = {}

    def shared(name: str, sensors: Sensors, *rig: Any) -> Scene:
        if (name, *rig) not in scenes:
            scenes[name, *rig] = load_scene(name, sensors, *rig)
        return scenes[name, *rig]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "load_scene", shared)
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Trainer]:
    """The run of an algorithm that was left alone, to look at and not to change."""
    runs: dict[str, Trainer] = {}

    def finished(algo: str) -> Trainer:
        if algo not in runs:
            runs[algo] = new_trainer(tiny(algo, tmp_path_factory.mktemp(algo) / "run"))
            assert runs[algo].run()
        return runs[algo]

    return finished


def stop_after(trainer: Trainer, updates: int) -> None:
    """Have the run stop as a signal stops it, during its n-th update."""
    update, count = trainer.parts.agent.update, iter(range(1, updates + 1))

    def counted(batch: Any) -> dict[str, float]:
        if next(count) == updates:
            trainer.stop.set()
        return update(batch)

    trainer.parts.agent.update = counted


def timeless(folder: Path) -> list[dict[str, str]]:
    rows = read_metrics(folder / "metrics.csv")
    return [{k: v for k, v in row.items() if k not in TIMES} for row in rows]


def state_of(folder: Path, which: str = "latest") -> Any:
    tree = load_tree(folder / "checkpoints" / f"{which}.safetensors")
    for timed in (tree["progress"], *tree["progress"]["rows"]):
        for name in TIMES:
            timed.pop(name, None)
    return tree


def assert_equal_runs(folder: Path, other: Path) -> None:
    """Metrics, checkpoints and policy, to the last bit."""
    assert timeless(folder) == timeless(other)
    for which in ("latest", "best"):
        assert_same(state_of(folder, which), state_of(other, which))
    policies = [load_policy(run) for run in (folder, other)]
    assert policies[0].card == policies[1].card
    assert_same(*[dict(policy.actor.state_dict()) for policy in policies])


@by_algorithm
def test_a_run_leaves_config_metrics_events_checkpoint_and_policy(
    algo: str, finished
) -> None:
    run = finished(algo)
    names = {path.name for path in run.folder.iterdir()}
    files = {"config.yaml", "metrics.csv", "run.lock"}
    assert names == files | {"checkpoints", "policy", "tensorboard"}
    recorded = yaml.safe_load((run.folder / "config.yaml").read_text())
    assert recorded.pop("versions")["torch"]
    assert from_dict(recorded) == run.config
    checkpoints = {path.stem for path in (run.folder / "checkpoints").iterdir()}
    assert checkpoints == {"latest", "previous", "best"}
    assert state_of(run.folder)["progress"]["env_steps"] == run.state.env_steps == 512


@by_algorithm
def test_metrics_are_rows_of_growing_steps_at_every_evaluation(algo, finished) -> None:
    rows = read_metrics(finished(algo).folder / "metrics.csv")
    steps = [int(row["env_steps"]) for row in rows]
    every = [-(-due // ROLLOUT[algo]) * ROLLOUT[algo] for due in (192, 384, 512)]
    assert steps == every
    seconds = [float(row["seconds"]) for row in rows]
    assert seconds == sorted(seconds)
    for name, value in rows[-1].items():
        assert math.isfinite(float(value)), name
    groups = {name.split("/")[0] for name in rows[-1]}
    assert groups >= {"env_steps", *TIMES, "train", "eval", "learn"}


@by_algorithm
def test_tensorboard_holds_what_metrics_hold(algo, finished) -> None:
    rows = read_metrics(finished(algo).folder / "metrics.csv")
    assert_tensorboard_holds(rows, finished(algo).folder)


def assert_tensorboard_holds(rows: list[dict[str, str]], folder: Path) -> None:
    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    assert set(events.Tags()["scalars"]) == set(rows[-1]) - {"env_steps"}
    found = [(event.step, event.value) for event in events.Scalars("eval/return")]
    expected = [(int(row["env_steps"]), float(row["eval/return"])) for row in rows]
    assert found == [pytest.approx(pair) for pair in expected]


def assert_holds(modules: dict[str, Any], weight: torch.Tensor) -> None:
    tensors = [tensor for state in modules.values() for tensor in state.values()]
    found = [tensor for tensor in tensors if tensor.shape == weight.shape]
    assert any(torch.equal(tensor, weight) for tensor in found)


def test_learning_rates_fall_to_zero_in_the_last_share(tmp_path, monkeypatch) -> None:
    run, found = new_trainer(tiny("sac", tmp_path / "run", cool_down=0.5)), []
    update = run.parts.agent.update

    def recorded(batch):
        (group,) = run.parts.agent.optimisers()["critic"].param_groups
        found.append((run.state.env_steps, group["lr"]))
        return update(batch)

    monkeypatch.setattr(run.parts.agent, "update", recorded)
    run.run()
    steps, rates = map(np.array, zip(*found, strict=True))
    expected = run.config.agent.learning_rate * np.minimum(1, 2 * (1 - steps / 512))
    np.testing.assert_allclose(rates, expected, atol=1e-12)
    assert steps[-1] == 512
    (group,) = run.parts.agent.optimisers()["critic"].param_groups
    run.state.env_steps += 64  # the last rollout may pass the end
    for share, rate in ((0.5, 0.0), (0.0, run.config.agent.learning_rate)):
        run.config = replace(run.config, cool_down=share)
        run._set_learning_rates()
        assert group["lr"] == rate


@by_algorithm
def test_the_policy_kept_is_the_best_evaluated_one(algo, finished) -> None:
    run = finished(algo)
    rows = read_metrics(run.folder / "metrics.csv")
    best = max(
        rows, key=lambda r: (float(r["eval/success_held"]), float(r["eval/return"]))
    )
    policy, checkpoint = load_policy(run.folder), state_of(run.folder, "best")
    card = policy.card
    assert card.env_steps == int(best["env_steps"])
    assert checkpoint["progress"]["env_steps"] == card.env_steps
    assert_holds(checkpoint["modules"], policy.actor.body[-1].weight)
    assert (card.task, card.robot, card.algo) == ("Reach", "Panda", algo)
    assert list(card.layout) == list(run.parts.evaluator.env.batch.layout)


def test_evaluations_are_of_the_same_episodes(tmp_path: Path) -> None:
    """A policy that does not learn is judged alike each time."""
    agent = {"learning_rate": 0.0, "normalise": False}
    config = tiny("ppo", tmp_path / "run", agent=agent)
    new_trainer(config).run()
    rows = read_metrics(config.folder / "metrics.csv")
    judged = [{k: v for k, v in row.items() if k.startswith("eval/")} for row in rows]
    assert len(judged) == 3
    assert judged[0] == judged[1] == judged[2]


@by_algorithm
def test_the_same_seed_gives_the_same_run_bit_for_bit(algo, finished, tmp_path) -> None:
    again = new_trainer(tiny(algo, tmp_path / "again"))
    assert again.run()
    assert_equal_runs(finished(algo).folder, again.folder)


@by_algorithm
@pytest.mark.parametrize("threads", [1, pytest.param(4, marks=pytest.mark.slow)])
def test_the_number_of_threads_does_not_change_a_run(
    threads: int, algo: str, finished, tmp_path: Path
) -> None:
    again = new_trainer(tiny(algo, tmp_path / "again", threads=threads))
    assert again.run()
    assert_equal_runs(finished(algo).folder, again.folder)


@pytest.mark.slow
@by_algorithm
def test_sixteen_worlds_give_the_same_run_twice(algo: str, tmp_path: Path) -> None:
    for name in ("first", "second"):
        assert new_trainer(tiny(algo, tmp_path / name, num_envs=16, steps=2048)).run()
    assert_equal_runs(tmp_path / "first", tmp_path / "second")


@pytest.mark.parametrize(("overlap", "ages"), [(True, [0, 1, 1, 1]), (False, [0] * 3)])
def test_overlap_acts_with_the_policy_of_one_round_before(
    overlap: bool, ages: list[int], tmp_path: Path
) -> None:
    config = tiny("sac", tmp_path / "run", overlap=overlap, steps=3 * ROLLOUT["sac"])
    trainer, rounds, known = new_trainer(config), [], []
    policy, update = trainer.parts.agent.policy, trainer.parts.agent.update
    trainer.parts.agent.policy = lambda: (known.append(len(rounds)), policy())[1]
    trainer.parts.agent.update = lambda batch: (update(batch), rounds.append(1))[0]
    assert trainer.run()
    assert [round_ - seen for round_, seen in enumerate(known)] == ages


def test_another_seed_gives_another_run(finished, tmp_path) -> None:
    other = new_trainer(tiny("ppo", tmp_path / "other", seed=1))
    assert other.run()
    pairs = zip(timeless(finished("ppo").folder), timeless(other.folder), strict=True)
    assert all(mine["eval/return"] != its["eval/return"] for mine, its in pairs)


@pytest.mark.parametrize(
    ("algo", "stops"),
    # Before, at and after an evaluation; before and after SAC begins to learn.
    [
        *(("bc", (3,)), ("ppo", (1, 2)), ("ppo", (4,)), ("sac", (2, 1))),
        *(("sac", (11,)), ("a3c", (5, 4))),
        *(
            pytest.param(algo, (3, 2), marks=pytest.mark.slow)
            for algo in sorted(AGENTS)
            if algo not in OFTEN
        ),
    ],
)
def test_an_interrupted_run_goes_on_bit_for_bit(
    algo: str, stops: tuple[int, ...], finished, tmp_path: Path
) -> None:
    config = tiny(algo, tmp_path / "run")
    for number, updates in enumerate(stops):
        trainer = new_trainer(replace(config, resume=number > 0))
        stop_after(trainer, updates)
        assert not trainer.run()
        assert trainer.state.env_steps == sum(stops[: number + 1]) * ROLLOUT[algo]
    assert new_trainer(replace(config, resume=True)).run()
    assert_equal_runs(finished(algo).folder, config.folder)


def test_a_finished_run_can_be_prolonged(finished, tmp_path: Path) -> None:
    short = tiny("ppo", tmp_path / "run", steps=384)
    assert new_trainer(short).run()
    assert new_trainer(replace(short, steps=512, resume=True)).run()
    assert_equal_runs(finished("ppo").folder, short.folder)


def copy_of(run: Trainer, folder: Path) -> TrainConfig:
    shutil.copytree(run.folder, folder)
    return replace(run.config, out=folder)


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_run_is_not_overwritten(finished) -> None:
    run = finished("ppo")
    before = contents(run.folder)
    with pytest.raises(
        UserError, match=f"{run.folder} already holds a run: .*--resume"
    ):
        new_trainer(run.config)
    assert contents(run.folder) == before


def test_nothing_is_not_resumed(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nothing to resume: there is no checkpoint"):
        new_trainer(tiny("ppo", tmp_path / "run", resume=True)).run()
    assert not (tmp_path / "run").exists()


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5])


def flip_a_bit(path: Path) -> None:
    whole = bytearray(path.read_bytes())
    whole[-99] ^= 4
    path.write_bytes(whole)


def torch_file(path: Path) -> None:
    torch.save({"format": 3}, path)


def rewrite(path: Path, change: Callable[[Any], Any]) -> None:
    tree = load_tree(path)
    change(tree)
    save_tree(path, tree)


DAMAGE = [truncate, lambda path: path.write_bytes(b""), flip_a_bit, torch_file]


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_run_goes_on_from_the_checkpoint_before_a_damaged_one(
    damage: Callable[[Path], Any], finished, tmp_path: Path
) -> None:
    run = finished("ppo")
    config = copy_of(run, tmp_path / "run")
    latest = config.folder / "checkpoints" / "latest.safetensors"
    damage(latest)
    again = new_trainer(replace(config, resume=True))
    with pytest.warns(UserWarning, match=f"{latest} is damaged.*; trying the checkpoint bef"):
        assert again.run()
    assert_equal_runs(run.folder, config.folder)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda t: [1], "has format None, this version reads"),
        (lambda t: t | {"format": 0}, "has format 0, this version reads"),
        (lambda t: t | {"collector": {}}, "is of another configuration"),
        (lambda t: t | {"torch_rng": 3}, "is of another configuration"),
        (lambda t: t | {"progress": {}}, "is damaged"),
        (lambda t: t | {"config": 7}, "is damaged"),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_told_and_costs_nothing(
    change: Callable[[Any], Any], told: str, finished, tmp_path: Path
) -> None:
    config = copy_of(finished("ppo"), tmp_path / "run")
    latest = config.folder / "checkpoints" / "latest.safetensors"
    save_tree(latest, change(load_tree(latest)))
    before = contents(config.folder)
    with pytest.raises(UserError, match=told):
        new_trainer(replace(config, resume=True)).run()
    assert contents(config.folder) == before


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": 1}, "seed was 0, not 1"),
        ({"num_envs": 3, "reward": "stock"}, "num_envs was 4, not 3; reward was"),
        ({"agent": {"gamma": 0.5}}, "agent.gamma was 0.97, not 0.5"),
        ({"algo": "sac"}, "algo was 'ppo', not 'sac'"),
    ],
)
def test_a_run_does_not_go_on_with_other_options(
    change: dict[str, Any], told: str, finished, tmp_path: Path
) -> None:
    change = dict(change)
    folder = copy_of(finished("ppo"), tmp_path / "run").folder
    other = tiny(change.pop("algo", "ppo"), folder, resume=True, **change)
    before = contents(folder)
    with pytest.raises(UserError, match=f"cannot go on with other options: .*{told}"):
        new_trainer(other).run()
    assert contents(folder) == before


def test_other_versions_are_told_when_a_run_goes_on(finished, tmp_path: Path) -> None:
    config = copy_of(finished("ppo"), tmp_path / "run")
    latest = config.folder / "checkpoints" / "latest.safetensors"
    rewrite(latest, lambda tree: tree["versions"].update(mujoco="2.0"))
    with pytest.warns(UserWarning, match=r"mujoco was 2.0, is .*not .* bit for bit"):
        assert new_trainer(replace(config, resume=True)).run()


def test_a_run_folder_is_for_one_process_at_a_time(finished, tmp_path: Path) -> None:
    config = copy_of(finished("ppo"), tmp_path / "run")
    before = contents(config.folder)
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, config.folder], stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout.readline() == "locked\n"
    told = f"is in use by process {holder.pid} on .*: wait for it, stop it, or"
    with pytest.raises(UserError, match=told):
        new_trainer(replace(config, resume=True)).run()
    holder.kill()
    holder.wait()
    assert contents(config.folder).keys() == before.keys()
    assert new_trainer(replace(config, resume=True)).run()


HOLD = """
import sys, time
from pathlib import Path
from manip.training.lifecycle import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


def test_a_full_disk_ends_a_run_that_goes_on_bit_for_bit(
    finished, tmp_path: Path, monkeypatch
) -> None:
    config = tiny("ppo", tmp_path / "run")
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    room = iter([None] * 12)

    def fsync(handle: int) -> None:
        if next(room, full):
            raise full

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", fsync)
        told = f"No space left on device; .*--resume --out {config.folder}"
        with pytest.raises(UserError, match=told):
            new_trainer(config).run()
    assert new_trainer(replace(config, resume=True)).run()
    assert_equal_runs(finished("ppo").folder, config.folder)


def test_logs_of_a_run_that_goes_on_hold_every_row_once(
    finished, tmp_path: Path
) -> None:
    run = finished("ppo")
    config = copy_of(run, tmp_path / "run")
    table = config.folder / "metrics.csv"
    expected = read_metrics(table)
    table.write_text(table.read_text()[:-7] + "1,2,3\n5")
    for events in (config.folder / "tensorboard").iterdir():
        events.write_bytes(events.read_bytes()[:-9])
    assert new_trainer(replace(config, resume=True)).run()
    assert read_metrics(table) == expected
    assert_tensorboard_holds(expected, config.folder)


def test_a_table_takes_up_its_rows_and_columns_may_come(tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    table = MetricsTable(path, [{"env_steps": 10, "a": 1.5}])
    table.add({"env_steps": 20, "a": 2.5, "b": 3})
    table.add({"env_steps": 30, "b": 4})
    assert [row["b"] for row in read_metrics(path)] == ["", "3", "4"]
    with path.open("a") as file:
        file.write("40,2")
    assert [row["env_steps"] for row in read_metrics(path)] == ["10", "20", "30"]


def test_a_run_goes_on_without_the_buffer_that_was_not_saved(
    tmp_path: Path, capsys
) -> None:
    config = tiny("sac", tmp_path / "run", save_buffer=False)
    trainer = new_trainer(config)
    stop_after(trainer, 11)
    assert not trainer.run()
    assert "replay buffer" not in capsys.readouterr().err
    lean = trainer.checkpoints.latest.stat().st_size
    again, counts = new_trainer(replace(config, save_buffer=True, resume=True)), []
    update = again.parts.agent.update

    def counted(batch: Any) -> dict[str, float]:
        found = update(batch)
        counts.append(again.parts.agent.extra_state()["updates"])
        return found

    again.parts.agent.update = counted
    with pytest.warns(UserWarning, match="holds no replay buffer: it is filled anew"):
        assert again.run()
    first, second, third, fourth, fifth = counts
    assert 0 < first == second == third < fourth < fifth
    said = capsys.readouterr().err
    assert re.search(r"MiB \(replay buffer: .*--no-save-buffer\)", said)
    rows = state_of(config.folder)["agent"]["buffer"]
    assert trainer.checkpoints.latest.stat().st_size > lean + rows.nbytes / 2


def test_faults_are_told_counted_and_kept_and_a_run_goes_on(
    tmp_path: Path, capsys
) -> None:
    config = tiny("ppo", tmp_path / "run")
    for updates in (1, None):
        trainer = new_trainer(replace(config, resume=updates is None))
        fall_ill(trainer.parts.envs[0].batch.task, 2)
        if updates:
            stop_after(trainer, updates)
        assert trainer.run() is (updates is None)
        told = capsys.readouterr().err
        assert "Reach: reward term 'near' of world 2 is not finite in step" in told
        assert told.count("its episode is lost") == 1
    rows = read_metrics(config.folder / "metrics.csv")
    assert [row["faults"] for row in rows] == ["2"] * 3
    assert len(list((config.folder / "dumps").iterdir())) == 2


def fall_ill(task: Any, world: int) -> None:
    """Have the task pay a world in NaN, in its sixth reward from now."""
    terms, number = task.reward_terms, iter(range(10_000))

    def ill(m: Any, reward: str) -> dict[str, np.ndarray]:
        found = terms(m, reward)
        if next(number) == 5:
            found["near"] = found["near"].copy()
            found["near"][world] = np.nan
        return found

    task.reward_terms = ill


@pytest.fixture(params=[signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def heard(request) -> Iterator[signal.Signals]:
    """A signal that is not ignored, as two of them are in the background of a shell."""
    before = signal.signal(request.param, signal.SIG_DFL)
    yield request.param
    signal.signal(request.param, before)


def test_a_signal_ends_the_run_after_its_update(heard, tmp_path, capfd) -> None:
    trainer = new_trainer(tiny("ppo", tmp_path / "run"))
    update = trainer.parts.agent.update

    def interrupted(batch: Any) -> dict[str, float]:
        signal.raise_signal(heard)
        return update(batch)

    trainer.parts.agent.update = interrupted
    assert not trainer.run()
    assert "repeat to quit at once" in capfd.readouterr().err
    assert signal.getsignal(heard) == signal.SIG_DFL
    assert state_of(trainer.folder)["progress"]["env_steps"] == ROLLOUT["ppo"]


def test_an_ignored_signal_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with SignalHandler(lambda: pytest.fail("heard")):
            signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_what_is_said_is_said_as_it_is(capsys) -> None:
    TerminalProgress().say("runs/[/a][b]")
    assert capsys.readouterr().err == "runs/[/a][b]\n"


def wait_for_metrics(path: Path, process: subprocess.Popen[str]) -> None:
    for _ in range(1200):
        if len(read_metrics(path)) > 1 or process.poll() is not None:
            return
        time.sleep(0.1)


def test_sigterm_saves_and_leaves_with_3_and_the_run_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = "--task Reach --algo ppo --num-envs 4 --eval-every 64 --eval-episodes 1"
    agent = "--agent.rollout-length 8 --agent.epochs 1 --agent.action-scale"
    command = [sys.executable, "-m", "manip.programs.main", "train", "--out", str(out)]
    process = subprocess.Popen(
        [*command, *options.split(), *agent.split()],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    wait_for_metrics(out / "metrics.csv", process)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 3, said
    assert "stopped at step" in said
    assert f"--resume --out {out}" in " ".join(said.split())
    done = state_of(out)["progress"]["env_steps"]
    more = ["--resume", "--out", str(out), "--steps", str(done + 64)]
    assert cli.run(train.main, more) == 0
    steps = [int(row["env_steps"]) for row in read_metrics(out / "metrics.csv")]
    assert steps == sorted(set(steps))
    assert steps[-1] == state_of(out)["progress"]["env_steps"] >= done + 64


def test_every_recipe_loads_for_the_task_and_algorithm_it_is_named_after() -> None:
    for name in recipe_names():
        task, algo = name.split("-", 1)
        names = {known.lower(): known for known in task_names()}
        found = recipe(names.get(task, task), algo)
        assert found != recipe("a task without a recipe", algo), name
        assert isinstance(found.agent, ALGORITHMS[algo])
        assert load_task(found.task).name.lower() == task
        assert found.eval_every <= found.steps


def test_a_recipe_may_say_more_of_some_arms() -> None:
    panda, jaco = (recipe("Lift", "bc", robot) for robot in ("Panda", "Jaco"))
    assert (panda.robot, jaco.robot) == ("Panda", "Jaco")
    assert panda == recipe("Lift", "bc")
    assert jaco.agent.noise < panda.agent.noise
    assert recipes("Jaco")["lift-bc"] == jaco
    assert train._defaults(["--algo", "bc", "--robot", "Jaco"]) == jaco


@pytest.mark.parametrize("algo", sorted(ALGORITHMS))
def test_options_survive_yaml(algo: str, tmp_path: Path) -> None:
    widths = next(o.name for o in fields(ALGORITHMS[algo]) if o.name.endswith("hidden"))
    config = tiny(algo, tmp_path / "run", seed=3, agent={widths: [8, 8]})
    assert from_dict(yaml.safe_load(yaml.safe_dump(to_dict(config)))) == config


def test_a_run_folder_is_named_after_what_is_trained() -> None:
    config = from_dict({"task": "my.tasks:Stack", "algo": "ppo", "seed": 4})
    assert config.folder == Path("runs/my.tasks.Stack-ppo-4")
    assert replace(config, out=Path("here")).folder == Path("here")


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"stepz": 1}, "unknown .*'stepz': did you mean 'steps'.*num_envs"),
        ({"agent": {"gama": 1}}, "unknown SACConfig .*'gama': did you mean 'gamma'"),
        ({"algo": "ppo", "agent": {"tau": 1}}, "unknown PPOConfig option.*clip"),
        ({"algo": "ddqn"}, "unknown algorithm 'ddqn': did you mean 'dqn'.*sac"),
        ({"agent": "fast"}, "must be a mapping, not 'fast'"),
        ({"agent": 3}, "must be a mapping, not 3"),
        ({"steps": 0}, "steps must be at least 1, not 0"),
        ({"eval_every": -1}, "eval_every must be at least 1, not -1"),
        ({"num_envs": "four"}, "num_envs must be a whole number, not 'four'"),
        ({"agent": {"batch_size": 0}}, "batch_size must be at least 1, not 0"),
        ({"seed": -1}, "seed must be at least 0, not -1"),
        ({"restart_fraction": 1.5}, "restart_fraction must be from 0 to 1, not 1.5"),
        ({"cool_down": -1}, "cool_down must be from 0 to 1, not -1"),
        ({"algo": "ppo", "agent": {"clip": 1.5}}, "clip must be from 0 to 1, not 1.5"),
        ({"algo": "ppo-kl", "agent": {"beta": 0}}, "beta must be at least 1e-09"),
    ],
)
def test_wrong_options_are_told(values: dict[str, Any], told: str) -> None:
    with pytest.raises(UserError, match=told):
        from_dict(values)


@by_algorithm
def test_a_policy_is_what_the_agent_would_do(algo, finished) -> None:
    run = finished(algo)
    policy = policy_of(run.parts.agent, run.config, run.parts.evaluator.env, run.state.env_steps)
    observation = run.parts.evaluator.env.observe()["observation"]
    assert torch.equal(policy(observation), run.parts.agent.actor.decide(observation))
    assert policy.card.observation_dim == observation.shape[1]
