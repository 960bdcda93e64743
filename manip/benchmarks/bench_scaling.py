"""Speed against the number of environments and threads, and of several models."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from manip.benchmarks.engine_steps import engine_at_start, repeated_steps, scene_of
from manip.benchmarks.rounds import (
    Candidate,
    Comparison,
    Measurements,
    Settings,
    speed,
)
from manip.cpus import usable_cpus
from manip.io.atomic_files import replace_file
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import load_scene
from manip.sim.sensors import Sensors

NUM_ENVS = (1, 4, 16, 64, 256, 1024)

MODELS = ("Door", "Lift", "Stack", "NutAssemblySquare", "PickPlaceCan")
"""robosuite environments with 9 to 33 degrees of freedom."""


def comparison(settings: Settings) -> Comparison:
    """Compare numbers of environments, numbers of threads, and models.

    Environments run on all CPUs; threads and models use `settings.num_envs`.
    """
    cpus, num_envs = usable_cpus(), settings.num_envs
    return Comparison(
        f"{settings.task}, up to {num_envs} environments on {cpus} threads, "
        "and other models",
        _engines(settings) | _models(num_envs),
        ratios={
            "most_envs_vs_one": (f"{num_envs} environments", "1 environments"),
            "all_threads_vs_one": (f"{cpus} threads", "1 threads"),
        },
    )


def _engines(settings: Settings) -> dict[str, Candidate]:
    scene, cpus, most = scene_of(settings.task), usable_cpus(), settings.num_envs
    counts = (*(n for n in NUM_ENVS if n < most), most)
    sizes = {f"{n} environments": (n, cpus) for n in counts}
    sizes |= {f"{n} threads": (most, n) for n in range(1, cpus + 1)}
    return {
        name: _speed_of(engine_at_start(settings.task, scene, *size))
        for name, size in sizes.items()
    }


def _models(num_envs: int) -> dict[str, Candidate]:
    candidates = {}
    for name in MODELS:
        scene = load_scene(name, Sensors())
        engine = BatchEngine(scene, num_envs, usable_cpus())
        candidates[f"{name}, {scene.physics.nv} dof"] = _speed_of(engine)
    return candidates


def _speed_of(engine: BatchEngine) -> Candidate:
    return speed(repeated_steps(engine))


def plot(measurements: Measurements, path: Path) -> None:
    """Draw medians and spreads against environments and threads, and per model."""
    panels = {"environments": "o-", "threads": "o-", "dof": "o"}
    figure, row = plt.subplots(
        *(1, 3), figsize=(13, 4), sharey=True, width_ratios=(3, 1, 4), layout="tight"
    )
    for axes, (kind, style) in zip(row, panels.items(), strict=True):
        _draw(axes, kind, style, measurements.rounds)
    row[0].set(ylabel="control steps per second", ylim=(0, None))
    row[2].set(xlabel="model and its degrees of freedom")
    figure.suptitle(measurements.comparison.title)
    replace_file(path, lambda part: figure.savefig(part, dpi=120))
    plt.close(figure)


def _draw(axes: Axes, kind: str, style: str, rounds: Mapping[str, list[float]]) -> None:
    values = {
        name.removesuffix(f" {kind}").replace(", ", "\n"): rates
        for name, rates in rounds.items()
        if name.endswith(f" {kind}")
    }
    median = np.array([np.median(rates) for rates in values.values()])
    below = median - [min(rates) for rates in values.values()]
    above = np.array([max(rates) for rates in values.values()]) - median
    places = range(len(values))
    axes.errorbar(places, median, (below, above), fmt=style, capsize=3)
    axes.set_xticks(places, list(values), fontsize="small")
    axes.set(xlabel=kind, xlim=(-0.5, len(values) - 0.5))
    axes.grid(alpha=0.3)
