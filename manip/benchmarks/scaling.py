"""What grows how: throughput against worlds, threads and the size of the model."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from manip.benchmarks.contest import Contest, Contestant, Outcome, Settings, speed
from manip.benchmarks.worlds import repeats, scene_of, started
from manip.cpus import usable_cpus
from manip.files import replace_file
from manip.sim.engine import BatchEngine
from manip.sim.handles import Sensors
from manip.sim.model import Scene, load_scene

WORLDS = (1, 4, 16, 64, 256, 1024)

MODELS = ("Door", "Lift", "Stack", "NutAssemblySquare", "PickPlaceCan")
"""robosuite environments with 9 to 33 degrees of freedom."""


def contest(settings: Settings) -> Contest:
    """Worlds on all threads; threads at `settings.worlds`; models at both."""
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
        contestants[f"{model.physics.nv} dof"] = _of(_resting(model, settings, cpus))
    largest = f"{settings.worlds} worlds"
    return Contest(
        f"{task}, up to {settings.worlds} worlds on {cpus} threads; "
        f"by dof: {', '.join(MODELS)}",
        contestants,
        ratios={
            "most_worlds_vs_one": (largest, "1 worlds"),
            "all_threads_vs_one": (f"{cpus} threads", "1 threads"),
        },
    )


def _of(engine: BatchEngine) -> Contestant:
    return speed(repeats(engine))


def _resting(scene: Scene, settings: Settings, threads: int) -> BatchEngine:
    return BatchEngine(scene, settings.worlds, threads)


def plot(outcome: Outcome, path: Path) -> None:
    """Draw medians and spreads: against worlds, threads and degrees of freedom."""
    panels = ("worlds", "threads", "dof")
    figure, row = plt.subplots(1, 3, figsize=(12, 4), sharey=True, layout="constrained")
    for axes, kind in zip(row, panels, strict=True):
        _draw(axes, kind, outcome.rounds)
    row[0].set(xscale="log", ylabel="control steps a second", ylim=(0, None))
    row[2].set(xlabel="degrees of freedom of the model")
    figure.suptitle(outcome.contest.title)
    replace_file(path, lambda part: figure.savefig(part, dpi=120))
    plt.close(figure)


def _draw(axes: Axes, kind: str, rounds: Mapping[str, list[float]]) -> None:
    found = {
        int(name.split()[0]): values
        for name, values in rounds.items()
        if name.endswith(f" {kind}")
    }
    sizes = sorted(found)
    middle = np.array([np.median(found[size]) for size in sizes])
    low = middle - [min(found[size]) for size in sizes]
    high = np.array([max(found[size]) for size in sizes]) - middle
    axes.errorbar(sizes, middle, (low, high), marker="o", capsize=3)
    axes.set(xlabel=kind)
    axes.grid(alpha=0.3)
