"""Train variants of a run with several seeds, and collect their evaluations."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from manip.agents.a3c import A3CConfig
from manip.agents.ppo import PPOConfig
from manip.cluster.executors import finish_runs
from manip.errors import UserError
from manip.training.config import TrainConfig, recorded
from manip.training.recipes import recipe
from manip.training.run_logs import read_metrics

EPOCHS = (1, 5, 20)
"""PPO's passes over a rollout that are compared."""

CLIPS = (0.2, None)
"""PPO's clip ranges that are compared."""

EVALUATIONS = 5
"""Evaluations of a run."""


@dataclass(frozen=True)
class Evaluation:
    """An evaluation during a run.

    Attributes:
        task, variant, seed: of the run.
        env_steps: control steps of training before it.
        cpu_seconds: computing time before it, without evaluations.
        success_held: rate of the goal being held at the end of an episode.
        kl: KL divergence of the latest update; nan where it is not logged.
    """

    task: str
    variant: str
    seed: int
    env_steps: int
    cpu_seconds: float
    success_held: float
    kl: float


def clipping_variants(task: str, steps: int | None) -> dict[str, TrainConfig]:
    """PPO with few and many epochs, with and without clipping, without early stop."""
    base = recipe(task, "ppo")
    agent = base.agent
    assert isinstance(agent, PPOConfig)
    base = _with_evaluations(replace(base, cool_down=0.0), steps)
    return {
        _name(epochs, clip): replace(
            base,
            agent=replace(agent, epochs=epochs, clip=clip, target_kl=None),
        )
        for clip in CLIPS
        for epochs in EPOCHS
    }


def _name(epochs: int, clip: float | None) -> str:
    noun = "epoch" if epochs == 1 else "epochs"
    return f"{epochs} {noun}, " + (f"clip {clip}" if clip else "no clip")


def asynchrony_variants(task: str, steps: int | None) -> dict[str, TrainConfig]:
    """A3C in turns, and asynchronous twice: with the same seeds, it differs."""
    turns = _with_evaluations(recipe(task, "a3c"), steps)
    assert isinstance(turns.agent, A3CConfig)
    free = replace(turns, agent=replace(turns.agent, asynchronous=True))
    return {"in turns": turns, "asynchronous": free, "asynchronous again": free}


def algorithm_variants(
    task: str, algos: Sequence[str], steps: int | None
) -> dict[str, TrainConfig]:
    """Algorithms with the options of their recipes for the task."""
    return {algo: _with_evaluations(recipe(task, algo), steps) for algo in algos}


def _with_evaluations(config: TrainConfig, steps: int | None) -> TrainConfig:
    """Set the number of steps (the recipe's own unless given) and of evaluations."""
    steps = steps or config.steps
    return replace(config, steps=steps, eval_every=max(1, steps // EVALUATIONS))


def evaluations(
    variants: Mapping[str, TrainConfig],
    seeds: Sequence[int],
    folder: Path,
    processes: int | None = None,
) -> list[Evaluation]:
    """Train every variant with every seed, in its own folder, and read its evaluations.

    A finished run is not repeated. An interrupted run is resumed.

    Args:
        variants: name -> options.
        seeds: of each variant.
        folder: for the run folders.
        processes: runs at a time; one for each usable CPU unless given.

    Raises:
        UserError: a folder holds a run with other options, or a damaged table; a run
            failed.
        KeyboardInterrupt: the runs were interrupted, and are saved.
    """
    runs = [
        (variant, _run(variant, config, seed, folder))
        for variant, config in variants.items()
        for seed in seeds
    ]
    for _, run in runs:
        _check_options(run)
    if finish_runs([run for _, run in runs], processes) is None:
        raise KeyboardInterrupt
    return [row for variant, run in runs for row in _read(run, variant)]


def _run(variant: str, config: TrainConfig, seed: int, folder: Path) -> TrainConfig:
    name = f"{config.task}-{variant}-{seed}".replace(" ", "-")
    return replace(config, seed=seed, out=folder / name)


def _check_options(run: TrainConfig) -> None:
    """Check that a run that exists in the folder has all options of this run.

    Runs that are evaluated at other steps cannot be compared.
    """
    if not (run.folder / "config.yaml").is_file():
        return
    stored = recorded(run.folder)
    if replace(stored, out=run.out, resume=run.resume, threads=run.threads) != run:
        raise UserError(
            f"{run.folder} holds a run with other options: remove it, or choose "
            "another folder with --out"
        )


def _read(run: TrainConfig, variant: str) -> list[Evaluation]:
    path = run.folder / "metrics.csv"
    try:
        rows = [row for row in read_metrics(path) if row["eval/success_held"]]
        return [_evaluation(run, variant, row) for row in rows]
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{path} is damaged: remove {run.folder} to run it again"
        ) from error


def _evaluation(run: TrainConfig, variant: str, row: Mapping[str, str]) -> Evaluation:
    return Evaluation(
        run.task,
        variant,
        run.seed,
        int(row["env_steps"]),
        float(row["cpu_seconds"]),
        float(row["eval/success_held"]),
        float(row.get("learn/kl") or math.nan),
    )
