"""Batch engines at the start of an episode, and rounds of steps that they repeat."""

from collections.abc import Callable

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task_registry import load_task
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Fidelity, Scene, load_scene

Array = np.ndarray

STEPS_PER_ROUND = 1280
"""Control steps of a round, over all environments: about a second on one core."""


def steps_per_env(num_envs: int) -> int:
    """Control steps T that each of N environments takes in a round."""
    return max(2, STEPS_PER_ROUND // num_envs)


def scene_of(name: str, fidelity: Fidelity = "exact") -> Scene:
    """Load the scene of a task by name."""
    task = load_task(name)
    return load_scene(task.robosuite_name, task.sensors, fidelity=fidelity)


def engine_at_start(
    task: str, scene: Scene, num_envs: int, threads: int
) -> BatchEngine:
    """Build an engine at the start of episode 0 of each environment, with seed 0."""
    engine, env_ids = BatchEngine(scene, num_envs, threads), np.arange(num_envs)
    streams = EpisodeStreams(0, env_ids, 0 * env_ids)
    start = load_task(task).sample_start(scene, streams)
    engine.reset(env_ids, start.qpos, start.fields)
    return engine


def random_actions(scene: Scene, num_envs: int) -> Array:
    """Uniform actions of a round, [T, N, A] in [-1, 1]; the same at every call."""
    shape = steps_per_env(num_envs), num_envs, scene.layout.action_dim
    return np.random.default_rng(0).uniform(-1, 1, shape)


def repeated_steps(engine: BatchEngine) -> Callable[[], int]:
    """Make a function that restores the engine's present state and steps a round."""
    actions = random_actions(engine.scene, engine.num_envs)
    state = engine.save()

    def run() -> int:
        engine.restore(state)
        for action in actions:
            engine.step(action)
        return len(actions) * engine.num_envs

    return run
