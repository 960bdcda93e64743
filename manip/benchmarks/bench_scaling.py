"""What grows how: throughput against worlds, threads and the size of the model."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from manip.benchmarks.contest import Contest, Contestant, Outcome, Settings, speed
from manip.benchmarks.task_envs import repeats, scene_of, started
from manip.cpus import usable_cpus
from manip.io.atomic_files import replace_file
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import load_scene
from manip.sim.sensors import Sensors

WORLDS = (1, 4, 16, 64, 256, 1024)

MODELS = ("Door", "Lift", "Stack", "NutAssemblySquare", "PickPlaceCan")
"""robosuite environments with 9 to 33 degrees of freedom."""


def contest(settings: Settings) -> Contest:
    """TaskBatch on all threads; threads at `settings.worlds`; models at both."""
    task, cpus = settings.task, usable_cpus()
    scene = scene_of(task)
    contestants: dict[str, Contestant] = {}
    for worlds in (*(n for n in WORLDS if n < settings.worlds), settings.worlds):
        contestants[f"{worlds} worlds"] = _of(started(task, scene, worlds, cpus))
    for threads in range(1, cpus + 1):
        engine = started(task, scene, settings.worlds, threads)
        contestants[f"{threads} threads"] = _of(engine)
    for name in MODELS:
        model = load_scene(name, Sensors())
        resting = BatchEngine(model, settings.worlds, cpus)
        contestants[f"{name}, {model.physics.nv} dof"] = _of(resting)
    largest = f"{settings.worlds} worlds"
    return Contest(
        f"{task}, up to {settings.worlds} worlds on {cpus} threads, and other models",
        contestants,
        ratios={
            "most_worlds_vs_one": (largest, "1 worlds"),
            "all_threads_vs_one": (f"{cpus} threads", "1 threads"),
        },
    )


def _of(engine: BatchEngine) -> Contestant:
    return speed(repeats(engine))


def plot(outcome: Outcome, path: Path) -> None:
    """Draw medians and spreads: against worlds and threads, and of each model."""
    panels = {"worlds": "o-", "threads": "o-", "dof": "o"}
    figure, row = plt.subplots(
        *(1, 3), figsize=(13, 4), sharey=True, width_ratios=(3, 1, 4), layout="tight"
    )
    for axes, (kind, style) in zip(row, panels.items(), strict=True):
        _draw(axes, kind, style, outcome.rounds)
    row[0].set(ylabel="control steps a second", ylim=(0, None))
    row[2].set(xlabel="model and its degrees of freedom")
    figure.suptitle(outcome.contest.title)
    replace_file(path, lambda part: figure.savefig(part, dpi=120))
    plt.close(figure)


def _draw(axes: Axes, kind: str, style: str, rounds: Mapping[str, list[float]]) -> None:
    found = {
        name.removesuffix(f" {kind}").replace(", ", "\n"): values
        for name, values in rounds.items()
        if name.endswith(f" {kind}")
    }
    middle = np.array([np.median(values) for values in found.values()])
    low = middle - [min(values) for values in found.values()]
    high = np.array([max(values) for values in found.values()]) - middle
    places = range(len(found))
    axes.errorbar(places, middle, (low, high), fmt=style, capsize=3)
    axes.set_xticks(places, list(found), fontsize="small")
    axes.set(xlabel=kind, xlim=(-0.5, len(found) - 0.5))
    axes.grid(alpha=0.3)
