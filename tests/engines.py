"""Engines whose environments have begun an episode, and actions for them."""

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Task
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Scene

Array = np.ndarray


def start(task: Task, engine: BatchEngine, seed: int = 0) -> None:
    """Begin an episode in every environment."""
    env_ids = np.arange(engine.num_envs)
    streams = EpisodeStreams(seed, env_ids, 0 * env_ids)
    engine.reset(env_ids, *task.sample_start(engine.scene, streams))


def started(task: Task, scene: Scene, num_envs: int, threads: int = 1) -> BatchEngine:
    engine = BatchEngine(scene, num_envs, threads)
    start(task, engine)
    return engine


def random_actions(steps: int, num_envs: int, action_dim: int = 7) -> Array:
    return np.random.default_rng(1).uniform(-1, 1, (steps, num_envs, action_dim))


def run(engine: BatchEngine, actions: Array) -> None:
    for action in actions:
        engine.step(action)


def close_in(task: Task, engine: BatchEngine, steps: int) -> None:
    """Step the expert until every gripper is in contact."""
    for _ in range(steps):
        engine.step(task.expert(task.measure(engine.read())))
