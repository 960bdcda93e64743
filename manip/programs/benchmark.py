"""`manip benchmark`: how fast the engine and the environment are, in ratios.

All contestants take turns in one process, round after round; the median of the rounds
counts, so that a machine's ups and downs hit all of them alike.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from manip.cpus import usable_cpus
from manip.envs.native import NativeEnv
from manip.envs.registry import load_task
from manip.files import write_text
from manip.programs import cli
from manip.sim.bare import bare_physics
from manip.sim.engine import BatchEngine
from manip.sim.model import Scene, load_scene
from manip.versions import versions

Round = Callable[[], int]
"""Runs for a moment; returns the control steps it took, all worlds together."""


@dataclass(frozen=True)
class Benchmark:
    """Measure speed in control steps a second, everything interleaved in one run.

    engine: the batch engine against stock robosuite and against MuJoCo's bare physics.
    env: the TorchRL environment (observe, reward, reset) against the bare engine.
    """

    what: Annotated[Literal["engine", "env"], tyro.conf.Positional]
    """Which benchmark."""
    task: str = "Lift"
    """Task that is simulated."""
    worlds: int = 64
    """Worlds of the engine."""
    rounds: int = 7
    """Rounds that all contestants run."""
    json: Path | None = None
    """Write the figures to this file, too."""


@dataclass(frozen=True)
class Speed:
    """Control steps a second: median, slowest and fastest round."""

    median: float
    slowest: float
    fastest: float


def main(arguments: Sequence[str]) -> int:
    """Run the benchmark and print its table."""
    options = cli.parse(Benchmark, arguments, "manip benchmark")
    load_task(options.task)
    contestants, ratios = _BENCHMARKS[options.what](options)
    speeds = _take_turns(contestants, options.rounds)
    figures = {
        name: speeds[over].median / speeds[under].median
        for name, (over, under) in ratios.items()
    }
    _print(speeds, figures, options)
    if options.json:
        record = {
            "figures": figures,
            "speeds": {name: asdict(speed) for name, speed in speeds.items()},
            "worlds": options.worlds,
            "cpus": usable_cpus(),
            "versions": versions(),
        }
        write_text(options.json, json.dumps(record, indent=2) + "\n")
    return 0


Contest = tuple[dict[str, Round], dict[str, tuple[str, str]]]
"""Contestants by name, and ratios: name -> (numerator, denominator)."""


def _engine(options: Benchmark) -> Contest:
    exact, fast = _scene(options, "exact"), _scene(options, "fast")
    cpus = usable_cpus()
    every = f"engine, exact, {cpus} threads"
    contestants = {
        "stock robosuite": _stock(exact),
        "bare physics, 1 thread": bare_physics(exact, steps=200),
        "engine, exact, 1 thread": _steps(exact, options.worlds, 1),
        every: _steps(exact, options.worlds, cpus),
        f"engine, fast, {cpus} threads": _steps(fast, options.worlds, cpus),
    }
    ratios = {
        "exact_per_core_vs_stock": ("engine, exact, 1 thread", "stock robosuite"),
        "exact_all_cores_vs_stock": (every, "stock robosuite"),
        "fast_all_cores_vs_stock": (f"engine, fast, {cpus} threads", "stock robosuite"),
        "exact_vs_bare_physics": ("engine, exact, 1 thread", "bare physics, 1 thread"),
        "all_threads_vs_one": (every, "engine, exact, 1 thread"),
    }
    return contestants, ratios


def _env(options: Benchmark) -> Contest:
    scene = _scene(options, "exact")
    env = NativeEnv(load_task(options.task), options.worlds, scene=scene, stagger=True)
    contestants = {
        "engine": _steps(scene, options.worlds, usable_cpus()),
        "TorchRL environment": _env_steps(env),
    }
    return contestants, {"env_vs_engine": ("TorchRL environment", "engine")}


_BENCHMARKS = {"engine": _engine, "env": _env}


def _scene(options: Benchmark, fidelity: Literal["exact", "fast"]) -> Scene:
    task = load_task(options.task)
    return load_scene(task.robosuite_name, task.sensors, fidelity=fidelity)


def _stock(scene: Scene, steps: int = 50) -> Round:
    env, rng = scene.stock, np.random.default_rng(0)

    def go() -> int:
        env.reset()
        for _ in range(steps):
            env.step(rng.uniform(-1, 1, env.action_dim))
        return steps

    return go


def _steps(scene: Scene, worlds: int, threads: int, steps: int = 10) -> Round:
    engine, rng = BatchEngine(scene, worlds, threads), np.random.default_rng(0)
    start = engine.save()
    shape = (worlds, scene.handles.action_dim)

    def go() -> int:
        engine.restore(start)
        for _ in range(steps):
            engine.step(rng.uniform(-1, 1, shape))
        return steps * worlds

    return go


def _env_steps(env: NativeEnv, steps: int = 10) -> Round:
    def go() -> int:
        state = env.reset()
        for _ in range(steps):
            state["action"] = torch.rand(env.action_spec.shape) * 2 - 1
            _, state = env.step_and_maybe_reset(state)
        return steps * env.num_worlds

    return go


def _take_turns(contestants: dict[str, Round], rounds: int) -> dict[str, Speed]:
    rates: dict[str, list[float]] = {name: [] for name in contestants}
    for turn in range(rounds + 1):
        for name, go in contestants.items():
            began = time.perf_counter()
            steps = go()
            if turn > 0:
                rates[name].append(steps / (time.perf_counter() - began))
    return {
        name: Speed(float(np.median(seen)), min(seen), max(seen))
        for name, seen in rates.items()
    }


def _print(
    speeds: dict[str, Speed], figures: dict[str, float], options: Benchmark
) -> None:
    console = Console()
    title = f"{options.task}, {options.worlds} worlds, {options.rounds} rounds"
    shown = Table(title=title)
    for column in ("contestant", "steps/s", "slowest", "fastest"):
        shown.add_column(column, justify="left" if column == "contestant" else "right")
    for name, speed in speeds.items():
        shown.add_row(name, *(f"{value:,.0f}" for value in asdict(speed).values()))
    console.print(shown)
    for name, figure in figures.items():
        console.print(f"{name.replace('_', ' ')}: {figure:.2f}", highlight=False)
