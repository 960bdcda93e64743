"""Compare with EnvPool's PandaPickCube at the same control rate.

Scene and control law (joint targets) differ: the comparison shows what a C++ simulator
of a Panda and a cube reaches, not which is better. Both take ten substeps of 5 ms per
control step. EnvPool also computes observations and rewards in C++, as the TorchRL
environment does in NumPy.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from manip.benchmarks.bench_env import random_steps
from manip.benchmarks.engine_steps import (
    engine_at_start,
    repeated_steps,
    scene_of,
    steps_per_env,
)
from manip.benchmarks.rounds import Comparison, Settings, speed
from manip.cpus import usable_cpus
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.make_batch import make_batch
from manip.errors import UserError

TASK = "PandaPickCube-v1"


def comparison(settings: Settings) -> Comparison:
    """Compare EnvPool, engine and environment, fast fidelity, on all CPUs."""
    task, num_envs, cpus = settings.task, settings.num_envs, usable_cpus()
    envpool_env = _make_envpool(num_envs)
    scene = scene_of(task, "fast")
    engine = engine_at_start(task, scene, num_envs, cpus)
    env = TaskEnv(make_batch(task, num_envs, scene=scene))
    names = f"EnvPool {TASK}", f"engine, fast, {task}", f"TorchRL env, fast, {task}"
    runs = _envpool_steps(envpool_env, num_envs), repeated_steps(engine)
    return Comparison(
        f"{num_envs} environments, {cpus} threads, 20 Hz in 5 ms substeps",
        dict(zip(names, map(speed, (*runs, random_steps(env))), strict=True)),
        ratios={
            "fast_engine_vs_envpool": (names[1], names[0]),
            "fast_env_vs_envpool": (names[2], names[0]),
        },
    )


def _make_envpool(num_envs: int) -> Any:
    try:
        import envpool
    except ImportError as error:
        raise UserError(
            f"`manip benchmark envpool` needs EnvPool ({error}): install it with "
            "`make peers`"
        ) from error
    threads = min(num_envs, usable_cpus())
    return envpool.make_gym(
        TASK, num_envs=num_envs, num_threads=threads, ctrl_dt=0.05, sim_dt=0.005
    )


def _envpool_steps(env: Any, num_envs: int) -> Callable[[], int]:
    steps = steps_per_env(num_envs)
    rng = np.random.default_rng(0)
    shape = num_envs, *env.action_space.shape
    env.reset()

    def run() -> int:
        for _ in range(steps):
            env.step(rng.uniform(-1, 1, shape).astype(np.float32))
        return steps * num_envs

    return run
