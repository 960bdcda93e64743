"""Training runs: what they leave behind, that they repeat themselves, and resume."""

import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from sameness import assert_same
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from manip.agents.policy import load_policy
from manip.envs import native
from manip.envs.registry import load_task, task_names
from manip.errors import UserError
from manip.programs import cli, train
from manip.sim.handles import Sensors
from manip.sim.model import Scene, load_scene
from manip.training.build import policy_of
from manip.training.config import (
    ALGORITHMS,
    TrainConfig,
    from_dict,
    recipe,
    recipe_names,
    to_dict,
)
from manip.training.logs import MetricsTable, read_metrics
from manip.training.loop import Trainer
from manip.trees import load_tree, save_tree

AGENTS = {
    "ppo": {"rollout_length": 16, "minibatches": 2, "epochs": 2},
    # The buffer is filled three times over; not every round updates the actor.
    "sac": {
        "random_steps": 128,
        "buffer_size": 160,
        "batch_size": 32,
        "actor_delay": 20,
    },
}
ROLLOUT = {"ppo": 4 * 16, "sac": 4 * 8}
"""Control steps between two updates."""
TIMES = ("seconds", "steps_per_second")
"""Columns that depend on the clock."""

by_algorithm = pytest.mark.parametrize("algo", sorted(AGENTS))


def tiny(algo: str, out: Path, **changes: Any) -> TrainConfig:
    agent = {"actor_hidden": [16], "critic_hidden": [16]} | AGENTS[algo]
    options = {
        "task": "Reach",
        "algo": algo,
        "out": str(out),
        "steps": 512,
        "num_worlds": 4,
        "horizon": 20,
        "eval_every": 192,
        "eval_episodes": 2,
        "agent": agent | changes.pop("agent", {}),
    }
    return from_dict(options | changes)


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
            runs[algo] = Trainer(tiny(algo, tmp_path_factory.mktemp(algo) / "run"))
            assert runs[algo].run()
        return runs[algo]

    return finished


def stop_after(trainer: Trainer, updates: int) -> None:
    """Have the run stop as a signal stops it, during its n-th update."""
    update, count = trainer.agent.update, iter(range(1, updates + 1))

    def counted(batch: Any) -> dict[str, float]:
        trainer.stopping = next(count) == updates
        return update(batch)

    trainer.agent.update = counted


def timeless(folder: Path) -> list[dict[str, str]]:
    rows = read_metrics(folder / "metrics.csv")
    return [{k: v for k, v in row.items() if k not in TIMES} for row in rows]


def state_of(folder: Path, which: str = "latest") -> Any:
    tree = load_tree(folder / "checkpoints" / f"{which}.safetensors")
    del tree["progress"]["seconds"]
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
    assert names == {"config.yaml", "metrics.csv", "tensorboard"} | {
        "checkpoints",
        "policy",
    }
    recorded = yaml.safe_load((run.folder / "config.yaml").read_text())
    assert recorded.pop("versions")["torch"]
    assert from_dict(recorded) == run.config
    checkpoints = {path.name for path in (run.folder / "checkpoints").iterdir()}
    assert checkpoints == {"latest.safetensors", "best.safetensors"}
    assert state_of(run.folder)["progress"]["env_steps"] == run.env_steps == 512


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
    folder = finished(algo).folder
    rows = read_metrics(folder / "metrics.csv")
    for logger in finished(algo)._log._loggers:
        logger.experiment.flush()
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
    run, found = Trainer(tiny("sac", tmp_path / "run", cool_down=0.5)), []
    update = run.agent.update

    def recorded(batch):
        (group,) = run.agent.optimisers()["critic"].param_groups
        found.append((run.env_steps, group["lr"]))
        return update(batch)

    monkeypatch.setattr(run.agent, "update", recorded)
    run.run()
    steps, rates = map(np.array, zip(*found, strict=True))
    expected = run.config.agent.learning_rate * np.minimum(1, 2 * (1 - steps / 512))
    np.testing.assert_allclose(rates, expected, atol=1e-12)
    assert steps[-1] == 512


@by_algorithm
def test_the_policy_kept_is_the_best_evaluated_one(algo, finished) -> None:
    run = finished(algo)
    rows = read_metrics(run.folder / "metrics.csv")
    best = max(rows, key=lambda r: (float(r["eval/held"]), float(r["eval/return"])))
    policy, checkpoint = load_policy(run.folder), state_of(run.folder, "best")
    card = policy.card
    assert card.env_steps == int(best["env_steps"])
    assert checkpoint["progress"]["env_steps"] == card.env_steps
    assert_holds(checkpoint["modules"], policy.actor.body[-1].weight)
    assert (card.task, card.robot, card.algo) == ("Reach", "Panda", algo)
    assert list(card.layout) == list(run.env.worlds.layout)


def test_evaluations_are_of_the_same_episodes(tmp_path: Path) -> None:
    """A policy that does not learn is judged alike each time."""
    agent = {"learning_rate": 0.0, "normalise": False}
    config = tiny("ppo", tmp_path / "run", agent=agent)
    Trainer(config).run()
    rows = read_metrics(config.folder / "metrics.csv")
    judged = [{k: v for k, v in row.items() if k.startswith("eval/")} for row in rows]
    assert len(judged) == 3
    assert judged[0] == judged[1] == judged[2]


@by_algorithm
def test_the_same_seed_gives_the_same_run_bit_for_bit(algo, finished, tmp_path) -> None:
    again = Trainer(tiny(algo, tmp_path / "again"))
    assert again.run()
    assert_equal_runs(finished(algo).folder, again.folder)


@by_algorithm
def test_the_number_of_threads_does_not_change_a_run(algo, finished, tmp_path) -> None:
    again = Trainer(tiny(algo, tmp_path / "again", threads=1))
    assert again.run()
    assert_equal_runs(finished(algo).folder, again.folder)


@pytest.mark.parametrize(("overlap", "ages"), [(True, [0, 1, 1, 1]), (False, [0] * 3)])
def test_overlap_acts_with_the_policy_of_one_round_before(
    overlap: bool, ages: list[int], tmp_path: Path
) -> None:
    config = tiny("sac", tmp_path / "run", overlap=overlap, steps=3 * ROLLOUT["sac"])
    trainer, rounds, known = Trainer(config), [], []
    policy, update = trainer.agent.policy, trainer.agent.update
    trainer.agent.policy = lambda: (known.append(len(rounds)), policy())[1]
    trainer.agent.update = lambda batch: (update(batch), rounds.append(1))[0]
    assert trainer.run()
    assert [round_ - seen for round_, seen in enumerate(known)] == ages


def test_another_seed_gives_another_run(finished, tmp_path) -> None:
    other = Trainer(tiny("ppo", tmp_path / "other", seed=1))
    assert other.run()
    pairs = zip(timeless(finished("ppo").folder), timeless(other.folder), strict=True)
    assert all(mine["eval/return"] != its["eval/return"] for mine, its in pairs)


@pytest.mark.parametrize(
    ("algo", "stops"),
    # Before, at and after an evaluation; before and after SAC begins to learn.
    [("ppo", (1, 2)), ("ppo", (4,)), ("sac", (2, 1)), ("sac", (11,))],
)
def test_an_interrupted_run_goes_on_bit_for_bit(
    algo: str, stops: tuple[int, ...], finished, tmp_path: Path
) -> None:
    config = tiny(algo, tmp_path / "run")
    for number, updates in enumerate(stops):
        trainer = Trainer(replace(config, resume=number > 0))
        stop_after(trainer, updates)
        assert not trainer.run()
        assert trainer.env_steps == sum(stops[: number + 1]) * ROLLOUT[algo]
    assert Trainer(replace(config, resume=True)).run()
    assert_equal_runs(finished(algo).folder, config.folder)


def test_a_finished_run_can_be_prolonged(finished, tmp_path: Path) -> None:
    short = tiny("ppo", tmp_path / "run", steps=384)
    assert Trainer(short).run()
    assert Trainer(replace(short, steps=512, resume=True)).run()
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
        Trainer(run.config)
    assert contents(run.folder) == before


def test_nothing_is_not_resumed(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nothing to resume: there is no"):
        Trainer(tiny("ppo", tmp_path / "run", resume=True))
    assert not (tmp_path / "run").exists()


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5])


def rewrite(path: Path, change: Callable[[Any], Any]) -> None:
    tree = load_tree(path)
    change(tree)
    save_tree(path, tree)


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (truncate, "is damaged or not a manip file"),
        (lambda path: path.write_bytes(b""), "is damaged or not a manip file"),
        (lambda path: save_tree(path, [1]), "has format None, not 3"),
        (partial(rewrite, change=lambda t: t.update(format=0)), "has format 0, not 3"),
        (
            partial(rewrite, change=lambda t: t.pop("collector")),
            "another configuration",
        ),
        (partial(rewrite, change=lambda t: t.update(torch_rng=3)), "another config"),
        (partial(rewrite, change=lambda t: t["progress"].clear()), "is damaged"),
    ],
)
def test_a_damaged_checkpoint_is_told_and_costs_nothing(
    damage: Callable[[Path], Any], told: str, finished, tmp_path: Path
) -> None:
    config = copy_of(finished("ppo"), tmp_path / "run")
    latest = config.folder / "checkpoints" / "latest.safetensors"
    damage(latest)
    before = contents(config.folder)
    with pytest.raises(UserError, match=f"{latest}.*{told}"):
        Trainer(replace(config, resume=True))
    assert contents(config.folder) == before


@pytest.mark.parametrize(
    "change", [{"num_worlds": 3}, {"agent": {"actor_hidden": [8]}}, {"algo": "sac"}]
)
def test_a_checkpoint_of_another_configuration_is_refused(
    change: dict[str, Any], finished, tmp_path: Path
) -> None:
    folder = copy_of(finished("ppo"), tmp_path / "run").folder
    other = tiny(change.pop("algo", "ppo"), folder, resume=True, **change)
    with pytest.raises(UserError, match=r"latest\.safetensors belongs to another conf"):
        Trainer(other)


def test_rows_beyond_the_checkpoint_are_dropped_and_columns_may_come(tmp_path) -> None:
    path = tmp_path / "metrics.csv"
    table = MetricsTable(path, upto=0)
    table.add({"env_steps": 10, "a": 1.5})
    table.add({"env_steps": 20, "a": 2.5, "b": 3})
    table.add({"env_steps": 30, "b": 4})
    assert [row["b"] for row in read_metrics(path)] == ["", "3", "4"]
    table = MetricsTable(path, upto=20)
    table.add({"env_steps": 25, "a": 0, "b": 0})
    assert [row["env_steps"] for row in read_metrics(path)] == ["10", "20", "25"]
    assert read_metrics(path)[1] == {"env_steps": "20", "a": "2.5", "b": "3"}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_run_after_its_update(number, tmp_path: Path) -> None:
    trainer = Trainer(tiny("ppo", tmp_path / "run"))
    update, before = trainer.agent.update, signal.getsignal(number)

    def interrupted(batch: Any) -> dict[str, float]:
        signal.raise_signal(number)
        return update(batch)

    trainer.agent.update = interrupted
    assert not trainer.run()
    assert signal.getsignal(number) == before
    assert state_of(trainer.folder)["progress"]["env_steps"] == ROLLOUT["ppo"]


def wait_for_metrics(path: Path, process: subprocess.Popen[str]) -> None:
    for _ in range(1200):
        if len(read_metrics(path)) > 1 or process.poll() is not None:
            return
        time.sleep(0.1)


def test_sigterm_saves_and_leaves_with_3_and_the_run_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = "--task Reach --algo ppo --num-worlds 4 --eval-every 64 --eval-episodes 1"
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
    assert "stopped and saved at step" in said
    assert f"--resume --out {out}" in " ".join(said.split())
    done = state_of(out)["progress"]["env_steps"]
    more = ["--resume", "--out", str(out), "--steps", str(done + 64)]
    assert cli.run(train.main, more) == 0
    steps = [int(row["env_steps"]) for row in read_metrics(out / "metrics.csv")]
    assert steps == sorted(set(steps))
    assert steps[-1] == state_of(out)["progress"]["env_steps"] >= done + 64


def test_every_recipe_loads_for_the_task_and_algorithm_it_is_named_after() -> None:
    for name in recipe_names():
        task, algo = name.split("-")
        names = {known.lower(): known for known in task_names()}
        found = recipe(names.get(task, task), algo)
        assert found != recipe("a task without a recipe", algo), name
        assert isinstance(found.agent, ALGORITHMS[algo])
        assert load_task(found.task).name.lower() == task
        assert found.eval_every <= found.steps


@pytest.mark.parametrize("algo", sorted(ALGORITHMS))
def test_options_survive_yaml(algo: str, tmp_path: Path) -> None:
    config = tiny(algo, tmp_path / "run", seed=3, agent={"action_scale": [0.5] * 7})
    assert from_dict(yaml.safe_load(yaml.safe_dump(to_dict(config)))) == config


def test_a_run_folder_is_named_after_what_is_trained() -> None:
    config = from_dict({"task": "my.tasks:Stack", "algo": "ppo", "seed": 4})
    assert config.folder == Path("runs/my.tasks.Stack-ppo-4")
    assert replace(config, out=Path("here")).folder == Path("here")


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"stepz": 1}, "unknown .*'stepz': did you mean 'steps'.*num_worlds"),
        ({"agent": {"gama": 1}}, "unknown .*SACConfig 'gama': did you mean 'gamma'"),
        ({"algo": "ppo", "agent": {"tau": 1}}, "unknown option of PPOConfig.*clip"),
        ({"algo": "dqn"}, "unknown algorithm 'dqn': known algorithms: sac, ppo"),
        ({"agent": "fast"}, "must be a mapping, not 'fast'"),
        ({"agent": 3}, "must be a mapping, not 3"),
        ({"steps": 0}, "steps must be at least 1, not 0"),
        ({"eval_every": -1}, "eval_every must be at least 1, not -1"),
        ({"num_worlds": "four"}, "num_worlds must be at least 1, not 'four'"),
        ({"agent": {"batch_size": 0}}, "batch_size must be at least 1, not 0"),
        ({"seed": -1}, "seed must be at least 0, not -1"),
        ({"own_starts": 1.5}, "own_starts must be from 0 to 1, not 1.5"),
        ({"cool_down": -1}, "cool_down must be from 0 to 1, not -1"),
    ],
)
def test_wrong_options_are_told(values: dict[str, Any], told: str) -> None:
    with pytest.raises(UserError, match=told):
        from_dict(values)


@by_algorithm
def test_a_policy_is_what_the_agent_would_do(algo, finished) -> None:
    run = finished(algo)
    policy = policy_of(run.agent, run.config, run.env, run.env_steps)
    observation = run.env.look()["observation"]
    assert torch.equal(policy(observation), run.agent.actor.decide(observation))
    assert policy.card.observation_dim == observation.shape[1]
