"""Speed of MuJoCo Warp: bare physics, engine and task, for several numbers of envs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from manip.arrays import on_host
from manip.benchmarks.engine_steps import scene_of
from manip.benchmarks.rounds import Candidate, Comparison, speed
from manip.envs.make_batch import make_batch
from manip.envs.task_batch import TaskBatch
from manip.sim.scene import Fidelity, Scene
from manip.sim.warp.library import Device, check_library
from manip.sim.warp.sizes import sizes_of

STEPS = {"cuda": 50, "cpu": 4}
"""Control steps that each environment takes in a round."""


@dataclass(frozen=True)
class GpuSettings:
    """What is measured.

    Attributes:
        num_envs: numbers of environments.
    """

    task: str
    fidelity: Fidelity
    device: Device
    num_envs: Sequence[int]


def comparison(settings: GpuSettings) -> Comparison:
    """Compare physics without control law, the engine, and the task, for each N.

    Raises:
        UserError: a package is missing, or there is no such device.
    """
    check_library(settings.device)
    scene = scene_of(settings.task, settings.fidelity)
    candidates: dict[str, Candidate] = {}
    facts: dict[str, float] = {}
    for num_envs in settings.num_envs:
        parts, bytes_per_env = _parts(settings, scene, num_envs)
        candidates |= {f"{name}, {num_envs} envs": run for name, run in parts.items()}
        facts[f"bytes_per_env_of_{num_envs}"] = bytes_per_env
    return Comparison(
        f"{settings.task}, {settings.fidelity}, MuJoCo Warp on {settings.device}",
        candidates,
        facts=facts,
        task=settings.task,
    )


def _parts(
    settings: GpuSettings, scene: Scene, num_envs: int
) -> tuple[dict[str, Candidate], float]:
    """Candidates for one number of environments, and the device's memory for each."""
    from manip.sim.warp.bare_steps import bare_steps  # needs the extra `gpu`
    from manip.sim.warp.warp_engine import WarpEngine

    steps = STEPS[settings.device]
    host, device = (
        _batch(settings, scene, num_envs, tensors) for tensors in (False, True)
    )
    engine = WarpEngine(scene, num_envs, sizes_of(scene, None, None), settings.device)
    actions = np.zeros((num_envs, host.action_dim))
    parts = {
        "physics": speed(_repeated(bare_steps(engine), steps, num_envs)),
        "engine": speed(_repeated(lambda: engine.step(actions), steps, num_envs)),
        "task": speed(_task_steps(host, steps)),
    }
    if device.gives_tensors:
        parts["task on the device"] = speed(_task_steps(device, steps))
    return parts, engine.device_bytes_per_env


def _batch(
    settings: GpuSettings, scene: Scene, num_envs: int, tensors: bool
) -> TaskBatch:
    batch = make_batch(
        settings.task,
        num_envs,
        backend="warp",
        device=settings.device,
        tensors=tensors,
        scene=scene,
        fidelity=settings.fidelity,
    )
    batch.begin(np.arange(num_envs))
    return batch


def _repeated(
    step: Callable[[], object], steps: int, num_envs: int
) -> Callable[[], int]:
    def run() -> int:
        for _ in range(steps):
            step()
        return steps * num_envs

    return run


def _task_steps(batch: TaskBatch, steps: int) -> Callable[[], int]:
    """Random steps with rewards and observations; episodes that end begin again."""
    generator = np.random.default_rng(0)
    shape = batch.num_envs, batch.action_dim

    def run() -> int:
        for _ in range(steps):
            step = batch.step(generator.uniform(-1, 1, shape))
            batch.begin(np.flatnonzero(on_host(step.done)))
        return steps * batch.num_envs

    return run
