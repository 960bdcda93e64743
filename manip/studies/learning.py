"""How runs of several options learn: their evaluations, side by side."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from manip.agents.ppo import PPOConfig
from manip.errors import UserError
from manip.training.config import TrainConfig, recipe, recorded
from manip.training.run import train_or_resume
from manip.training.run_logs import read_metrics
from manip.training.terminal import TerminalProgress

EPOCHS = (1, 5, 20)
CLIPS = (0.2, None)


@dataclass(frozen=True)
class Evaluated:
    """One evaluation of one run, after so much computing time.

    kl is that of the update before, where it is told.
    """

    task: str
    variant: str
    seed: int
    env_steps: int
    cpu_seconds: float
    success_held: float
    kl: float


def clipping_variants(task: str, steps: int | None) -> dict[str, TrainConfig]:
    """PPO with few and many epochs, with and without clipping, never stopped early."""
    base = recipe(task, "ppo")
    agent = base.agent
    assert isinstance(agent, PPOConfig)
    base = _in_fifths(replace(base, cool_down=0.0), steps)
    return {
        _name(epochs, clip): replace(
            base,
            agent=replace(agent, epochs=epochs, clip=clip, target_kl=None),
        )
        for clip in CLIPS
        for epochs in EPOCHS
    }


def _name(epochs: int, clip: float | None) -> str:
    many = "epoch" if epochs == 1 else "epochs"
    return f"{epochs} {many}, " + (f"clip {clip}" if clip else "no clip")


def algorithm_variants(
    task: str, algos: Sequence[str], steps: int | None
) -> dict[str, TrainConfig]:
    """Algorithms, each as its recipe for the task has it."""
    return {algo: _in_fifths(recipe(task, algo), steps) for algo in algos}


def _in_fifths(config: TrainConfig, steps: int | None) -> TrainConfig:
    """So many steps, or the recipe's own, with five evaluations."""
    steps = steps or config.steps
    return replace(config, steps=steps, eval_every=max(1, steps // 5))


def evaluations(
    variants: Mapping[str, TrainConfig], seeds: Sequence[int], folder: Path
) -> Iterator[Evaluated]:
    """Run every variant with every seed, in folders of their own, and read them.

    Runs that are there already are not repeated; one that was stopped goes on.
    """
    for variant, config in variants.items():
        for seed in seeds:
            out = folder / f"{config.task}-{variant}-{seed}".replace(" ", "-")
            run = replace(config, seed=seed, out=out)
            yield from _finished(run, variant)


def _finished(run: TrainConfig, variant: str) -> list[Evaluated]:
    """The evaluations of a run, once what is left of it has been run."""
    _check_same(run)
    found = _read(run, variant)
    if found and found[-1].env_steps >= run.steps:
        return found
    with TerminalProgress() as progress:
        if not train_or_resume(run, callback=progress).finished:
            raise KeyboardInterrupt
    return _read(run, variant)


def _check_same(run: TrainConfig) -> None:
    """A run that is there already must be the one that is asked for."""
    if not (run.folder / "config.yaml").is_file():
        return
    there = recorded(run.folder)
    if replace(there, out=run.out, resume=run.resume, threads=run.threads) != run:
        raise UserError(
            f"{run.folder} holds a run with other options: remove it, or choose "
            "another folder with --out"
        )


def _read(run: TrainConfig, variant: str) -> list[Evaluated]:
    path = run.folder / "metrics.csv"
    try:
        return [
            Evaluated(
                run.task,
                variant,
                run.seed,
                int(row["env_steps"]),
                float(row["cpu_seconds"]),
                float(row["eval/success_held"]),
                float(row.get("learn/kl") or math.nan),
            )
            for row in read_metrics(path)
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{path} is damaged: remove {run.folder} to run it again"
        ) from error
