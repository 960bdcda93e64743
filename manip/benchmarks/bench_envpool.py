"""EnvPool's PandaPickCube at our control rate: a neighbour in physics throughput.

Another scene and another control law (joint targets): it tells what a C++ simulator
of a Panda and a cube reaches, not who is better. Both take ten 5 ms substeps a control
step; on top, EnvPool computes observations and rewards in C++, which our environment
computes in numpy.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from manip.benchmarks.bench_env import random_steps
from manip.benchmarks.contest import Contest, Settings, speed
from manip.benchmarks.task_envs import STEPS_A_ROUND, repeats, scene_of, started
from manip.cpus import usable_cpus
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.make_batch import make_batch
from manip.errors import UserError

TASK = "PandaPickCube-v1"


def contest(settings: Settings) -> Contest:
    """EnvPool, our engine and our environment, fast fidelity, on all threads."""
    peer = _peer(settings.worlds)
    scene = scene_of(settings.task, "fast")
    engine = started(settings.task, scene, settings.worlds, usable_cpus())
    env = TaskEnv(make_batch(settings.task, settings.worlds, scene=scene))
    return Contest(
        f"{settings.worlds} worlds, {usable_cpus()} threads, 20 Hz in 5 ms substeps",
        {
            f"EnvPool {TASK}": speed(_peer_steps(peer, settings.worlds)),
            f"engine, fast, {settings.task}": speed(repeats(engine)),
            f"TorchRL environment, fast, {settings.task}": speed(random_steps(env)),
        },
        ratios={
            "fast_engine_vs_envpool": (
                f"engine, fast, {settings.task}",
                f"EnvPool {TASK}",
            ),
            "fast_env_vs_envpool": (
                f"TorchRL environment, fast, {settings.task}",
                f"EnvPool {TASK}",
            ),
        },
    )


def _peer(worlds: int) -> Any:
    try:
        import envpool
    except ImportError as error:
        raise UserError(
            f"`manip benchmark envpool` needs EnvPool ({error}): install the extra, "
            "`make peers`"
        ) from error
    threads = min(worlds, usable_cpus())
    return envpool.make_gym(
        TASK, num_envs=worlds, num_threads=threads, ctrl_dt=0.05, sim_dt=0.005
    )


def _peer_steps(env: Any, worlds: int) -> Callable[[], int]:
    steps = max(2, STEPS_A_ROUND // worlds)
    rng = np.random.default_rng(0)
    shape = worlds, *env.action_space.shape
    env.reset()

    def go() -> int:
        for _ in range(steps):
            env.step(rng.uniform(-1, 1, shape).astype(np.float32))
        return steps * worlds

    return go
