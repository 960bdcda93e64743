"""Small training runs, and how two of them are compared."""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from sameness import assert_same
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from manip.envs.backends import native_batch as native
from manip.io.tensor_trees import load_tree, save_tree
from manip.rewards.reward_function import EnvironmentReward, RewardFunction
from manip.sim.scene import Scene, load_scene
from manip.sim.sensors import Sensors
from manip.training.config import (
    TrainConfig,
    from_dict,
)
from manip.training.run_logs import read_metrics
from manip.training.terminal import TerminalProgress
from manip.training.trainer import Trainer

AGENTS = {
    "bc": {"rollout_length": 8, "batch_size": 32, "buffer_size": 160},
    "gaussian-bc": {"rollout_length": 8, "batch_size": 32, "buffer_size": 160},
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
    agent = {hidden: [16]} | AGENTS.get(algo, {})
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


_scenes: dict[Any, Scene] = {}


def shared_scene(name: str, sensors: Sensors, *options: Any) -> Scene:
    """A compiled scene, built once: that takes longest in a small run."""
    if (name, *options) not in _scenes:
        _scenes[name, *options] = load_scene(name, sensors, *options)
    return _scenes[name, *options]


def new_trainer(config: TrainConfig, reward: RewardFunction | None = None) -> Trainer:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "load_scene", shared_scene)
        reward = reward or EnvironmentReward()
        return Trainer(config, TerminalProgress(), reward, Event())


_finished_runs = tempfile.TemporaryDirectory(prefix="runs-")


@cache
def finished(algo: str) -> Trainer:
    """The uninterrupted run of an algorithm; tests read it and do not change it."""
    trainer = new_trainer(tiny(algo, Path(_finished_runs.name) / algo / "run"))
    assert trainer.run()
    return trainer


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


def choices(folder: Path) -> list[dict[str, str]]:
    """The rows of the evaluations that choose the policy."""
    return [row for row in read_metrics(folder / "metrics.csv") if row["eval/return"]]


def state_of(folder: Path, which: str = "latest") -> Any:
    tree = load_tree(folder / "checkpoints" / f"{which}.safetensors")
    for timed in (tree["progress"], *tree["progress"]["rows"]):
        for name in TIMES:
            timed.pop(name, None)
    return tree


def assert_equal_runs(folder: Path, other: Path) -> None:
    """Compare metrics, checkpoints and policy, to the last bit."""
    assert timeless(folder) == timeless(other)
    for which in ("latest", "best"):
        assert_same(state_of(folder, which), state_of(other, which))
    policies = [run / "policy" / "policy.safetensors" for run in (folder, other)]
    assert policies[0].read_bytes() == policies[1].read_bytes()


def assert_tensorboard_holds(rows: list[dict[str, str]], folder: Path) -> None:
    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    assert set(events.Tags()["scalars"]) == set(rows[-1]) - {"env_steps"}
    for name in ("eval/return", "curve/return", "train/return"):
        scalars = [(event.step, event.value) for event in events.Scalars(name)]
        held = [(int(row["env_steps"]), row[name]) for row in rows if row[name]]
        assert scalars == [pytest.approx((step, float(v))) for step, v in held]


def copy_of(run: Trainer, folder: Path) -> TrainConfig:
    shutil.copytree(run.folder, folder)
    return replace(run.config, out=folder)


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rewrite(path: Path, change: Callable[[Any], Any]) -> None:
    tree = load_tree(path)
    change(tree)
    save_tree(path, tree)
