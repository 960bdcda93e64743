"""The batch engine against MuJoCo's bare physics and against stock robosuite."""

from collections.abc import Callable

from manip.benchmarks.contest import Contest, Contestant, Settings, speed
from manip.benchmarks.stock_speed import stock_processes, stock_steps
from manip.benchmarks.task_envs import random_actions, repeats, scene_of, started
from manip.cpus import usable_cpus
from manip.sim.bare_physics import bare_physics
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Scene


def contest(settings: Settings) -> Contest:
    """Exact and fast fidelity, on one thread and on all.

    Bare physics is `mujoco.rollout` of the same model, which repeats, in C and on as
    many threads, the very controls that the engine applies.
    """
    task, worlds, cpus = settings.task, settings.worlds, usable_cpus()
    exact, fast = scene_of(task, "exact"), scene_of(task, "fast")
    one = started(task, exact, worlds, 1)
    every = started(task, exact, worlds, cpus)
    contestants: dict[str, Contestant] = {
        "stock, 1 process": speed(stock_steps(exact.stock)),
        f"stock, {_count(cpus, 'process')}": speed(stock_processes(task, cpus)),
        "bare physics, 1 thread": speed(_bare(exact, one, 1)),
        "engine, exact, 1 thread": speed(repeats(one)),
        f"bare physics, {_count(cpus, 'thread')}": speed(_bare(exact, every, cpus)),
        f"engine, exact, {_count(cpus, 'thread')}": speed(repeats(every)),
        f"engine, fast, {_count(cpus, 'thread')}": speed(
            repeats(started(task, fast, worlds, cpus))
        ),
    }
    stock, all_threads = "stock, 1 process", _count(cpus, "thread")
    exact_all = f"engine, exact, {all_threads}"
    return Contest(
        f"{task}, {worlds} worlds",
        contestants,
        ratios={
            "exact_vs_bare_1_thread": (
                "engine, exact, 1 thread",
                "bare physics, 1 thread",
            ),
            "exact_vs_bare_all_threads": (exact_all, f"bare physics, {all_threads}"),
            "exact_1_thread_vs_stock": ("engine, exact, 1 thread", stock),
            "exact_all_threads_vs_stock": (exact_all, stock),
            "exact_vs_stock_processes": (
                exact_all,
                f"stock, {_count(cpus, 'process')}",
            ),
            "fast_all_threads_vs_stock": (f"engine, fast, {all_threads}", stock),
            "all_threads_vs_one": (exact_all, "engine, exact, 1 thread"),
        },
        facts={"memory_per_world_kib": every.bytes_per_env / 1024},
    )


def _count(number: int, noun: str) -> str:
    plural = {"thread": "threads", "process": "processes"}[noun]
    return f"{number} {noun if number == 1 else plural}"


def _bare(scene: Scene, engine: BatchEngine, threads: int) -> Callable[[], int]:
    actions = random_actions(scene, engine.num_envs)
    run = bare_physics(engine, actions, threads)

    def go() -> int:
        run()
        return len(actions) * engine.num_envs

    return go
