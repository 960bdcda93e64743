"""Compare the batch engine with MuJoCo's bare physics and with stock robosuite."""

from collections.abc import Callable

from manip.benchmarks.engine_steps import (
    engine_at_start,
    random_actions,
    repeated_steps,
    scene_of,
)
from manip.benchmarks.rounds import Candidate, Comparison, Settings, speed
from manip.benchmarks.stock_steps import stock_processes, stock_steps
from manip.cpus import usable_cpus
from manip.sim.bare_physics import bare_physics
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Scene

STOCK = "stock, 1 process"


def comparison(settings: Settings) -> Comparison:
    """Compare exact and fast fidelity, on one thread and on all CPUs.

    Bare physics is `mujoco.rollout` of the same model. It repeats the controls that
    the engine applies, in C, on the same number of threads.
    """
    exact = scene_of(settings.task, "exact")
    engines = {
        threads: engine_at_start(settings.task, exact, settings.num_envs, threads)
        for threads in (1, usable_cpus())
    }
    return Comparison(
        f"{settings.task}, {settings.num_envs} environments",
        _stock(settings.task, exact) | _exact(exact, engines) | _fast(settings),
        ratios=_ratios(usable_cpus()),
        facts={"memory_per_env_kib": engines[1].bytes_per_env / 1024},
    )


def _stock(task: str, scene: Scene) -> dict[str, Candidate]:
    several = f"stock, {_count(usable_cpus(), 'process')}"
    return {
        STOCK: speed(stock_steps(scene.stock)),
        several: speed(stock_processes(task, usable_cpus())),
    }


def _exact(scene: Scene, engines: dict[int, BatchEngine]) -> dict[str, Candidate]:
    candidates: dict[str, Candidate] = {}
    for threads, engine in engines.items():
        count = _count(threads, "thread")
        candidates[f"bare physics, {count}"] = speed(_bare(scene, engine, threads))
        candidates[f"engine, exact, {count}"] = speed(repeated_steps(engine))
    return candidates


def _fast(settings: Settings) -> dict[str, Candidate]:
    scene, cpus = scene_of(settings.task, "fast"), usable_cpus()
    engine = engine_at_start(settings.task, scene, settings.num_envs, cpus)
    return {f"engine, fast, {_count(cpus, 'thread')}": speed(repeated_steps(engine))}


def _ratios(cpus: int) -> dict[str, tuple[str, str]]:
    one, every = "1 thread", _count(cpus, "thread")
    exact, exact_all = f"engine, exact, {one}", f"engine, exact, {every}"
    processes = f"stock, {_count(cpus, 'process')}"
    return {
        "exact_vs_bare_1_thread": (exact, f"bare physics, {one}"),
        "exact_vs_bare_all_threads": (exact_all, f"bare physics, {every}"),
        "exact_1_thread_vs_stock": (exact, STOCK),
        "exact_all_threads_vs_stock": (exact_all, STOCK),
        "exact_vs_stock_processes": (exact_all, processes),
        "fast_all_threads_vs_stock": (f"engine, fast, {every}", STOCK),
        "all_threads_vs_one": (exact_all, exact),
    }


def _count(number: int, noun: str) -> str:
    plural = {"thread": "threads", "process": "processes"}[noun]
    return f"{number} {noun if number == 1 else plural}"


def _bare(scene: Scene, engine: BatchEngine, threads: int) -> Callable[[], int]:
    actions = random_actions(scene, engine.num_envs)
    rollout = bare_physics(engine, actions, threads)

    def run() -> int:
        rollout()
        return len(actions) * engine.num_envs

    return run
