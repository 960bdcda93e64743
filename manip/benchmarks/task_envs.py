"""Engines that stand where episodes begin, for benchmarks to drive."""

from collections.abc import Callable

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task_registry import load_task
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Fidelity, Scene, load_scene

Array = np.ndarray

STEPS_A_ROUND = 1280
"""Control steps of a round, all worlds together: about a second of one core."""


def scene_of(task: str, fidelity: Fidelity = "exact") -> Scene:
    """The scene of a task by name."""
    found = load_task(task)
    return load_scene(found.robosuite_name, found.sensors, fidelity=fidelity)


def started(task: str, scene: Scene, worlds: int, threads: int) -> BatchEngine:
    """An engine whose worlds have just begun the same episodes, whatever threads."""
    engine, each = BatchEngine(scene, worlds, threads), np.arange(worlds)
    start = load_task(task).sample_start(scene, EpisodeStreams(0, each, 0 * each))
    engine.reset(each, start.qpos, start.fields)
    return engine


def random_actions(scene: Scene, worlds: int) -> Array:
    """The actions of a round: [T, N, A] in [-1, 1], always the same."""
    steps = max(2, STEPS_A_ROUND // worlds)
    shape = steps, worlds, scene.layout.action_dim
    return np.random.default_rng(0).uniform(-1, 1, shape)


def repeats(engine: BatchEngine) -> Callable[[], int]:
    """A function that takes the round's steps from where the engine stands now."""
    actions = random_actions(engine.scene, engine.num_envs)
    begin = engine.save()

    def go() -> int:
        engine.restore(begin)
        for action in actions:
            engine.step(action)
        return len(actions) * engine.num_envs

    return go
