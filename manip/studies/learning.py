"""How runs of several options learn: their evaluations, side by side."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from manip.agents.ppo import PPOConfig
from manip.training.config import TrainConfig, recipe
from manip.training.logs import read_metrics
from manip.training.loop import Trainer

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
    held: float
    kl: float


def clipping_variants(task: str, steps: int | None) -> dict[str, TrainConfig]:
    """PPO with few and many epochs, with and without clipping, never stopped early."""
    base = recipe(task, "ppo")
    agent = base.agent
    assert isinstance(agent, PPOConfig)
    base = replace(base, steps=steps or base.steps, cool_down=0.0)
    return {
        _name(epochs, clip): replace(
            base,
            eval_every=max(1, base.steps // 5),
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
    found = {algo: recipe(task, algo) for algo in algos}
    return {
        algo: replace(config, steps=steps or config.steps, eval_every=_often(config))
        for algo, config in found.items()
    }


def _often(config: TrainConfig) -> int:
    return max(1, config.steps // 5)


def evaluations(
    variants: Mapping[str, TrainConfig], seeds: Sequence[int], folder: Path
) -> Iterator[Evaluated]:
    """Run every variant with every seed, in folders of their own, and read them.

    Runs that are there already are not repeated; one that was stopped goes on.
    """
    for variant, config in variants.items():
        for seed in seeds:
            out = folder / f"{config.task}-{variant}-{seed}".replace(" ", "-")
            _run(replace(config, seed=seed, out=out))
            for row in read_metrics(out / "metrics.csv"):
                yield _evaluated(config.task, variant, seed, row)


def _run(config: TrainConfig) -> None:
    rows = read_metrics(config.folder / "metrics.csv")
    if rows and int(rows[-1]["env_steps"]) >= config.steps:
        return
    latest = config.folder / "checkpoints" / "latest.safetensors"
    if not Trainer(replace(config, resume=latest.is_file())).run():
        raise KeyboardInterrupt


def _evaluated(task: str, variant: str, seed: int, row: Mapping[str, str]) -> Evaluated:
    return Evaluated(
        task,
        variant,
        seed,
        int(row["env_steps"]),
        float(row["cpu_seconds"]),
        float(row["eval/held"]),
        float(row.get("learn/kl") or math.nan),
    )
