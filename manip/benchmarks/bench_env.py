"""What stands on the engine, as a share of it: the environment, the collect loop."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from manip.agents.sac import SACConfig
from manip.benchmarks.contest import Contest, Settings, speed
from manip.benchmarks.task_envs import STEPS_A_ROUND, repeats, scene_of, started
from manip.cpus import usable_cpus
from manip.envs.adapters.gymnasium import TaskVectorEnv
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.make_batch import make_batch
from manip.envs.task_registry import load_task
from manip.sim.scene import Scene
from manip.training.build import build_agent
from manip.training.collector import Rollout
from manip.training.config import recipe


def contest(settings: Settings) -> Contest:
    """Engine; environments on it (observe, reward, reset); collect loop with SAC."""
    torch.set_num_threads(1)  # as training does: torch's threads wait by spinning
    task, scene = settings.task, scene_of(settings.task)
    engine = started(task, scene, settings.worlds, usable_cpus())
    return Contest(
        f"{task}, {settings.worlds} worlds, {usable_cpus()} threads",
        {
            "engine": speed(repeats(engine)),
            "TorchRL environment": speed(random_steps(_env(settings, scene))),
            "Gymnasium vector environment": speed(_vector_steps(settings, scene)),
            "collect loop with SAC policy": speed(
                _collect(_env(settings, scene), settings.task)
            ),
        },
        ratios={
            "env_vs_engine": ("TorchRL environment", "engine"),
            "gymnasium_vs_engine": ("Gymnasium vector environment", "engine"),
            "collect_vs_engine": ("collect loop with SAC policy", "engine"),
        },
    )


def _env(settings: Settings, scene: Scene) -> TaskEnv:
    task = load_task(settings.task)
    return TaskEnv(make_batch(task, settings.worlds, scene=scene, stagger=True))


def random_steps(env: TaskEnv) -> Callable[[], int]:
    """A function that resets an environment and acts at random in it."""
    steps = max(2, STEPS_A_ROUND // env.worlds.num_envs)

    def go() -> int:
        state = env.reset()
        for _ in range(steps):
            state["action"] = torch.rand(env.action_spec.shape) * 2 - 1
            _, state = env.step_and_maybe_reset(state)
        return steps * env.worlds.num_envs

    return go


def _vector_steps(settings: Settings, scene: Scene) -> Callable[[], int]:
    envs = TaskVectorEnv(settings.task, settings.worlds, scene=scene, stagger=True)
    steps = max(2, STEPS_A_ROUND // envs.num_envs)
    rng, shape = np.random.default_rng(0), envs.action_space.shape

    def go() -> int:
        envs.reset()
        for _ in range(steps):
            envs.step(rng.uniform(-1, 1, shape))
        return steps * envs.num_envs

    return go


def _collect(env: TaskEnv, task: str) -> Callable[[], int]:
    """The worlds go on where they stopped, as in training, with an untrained actor."""
    config = recipe(task, "sac")
    assert isinstance(config.agent, SACConfig)
    acting = replace(config.agent, random_steps=0)
    agent = build_agent(replace(config, agent=acting), env)
    rollout = Rollout(env)
    length = max(2, STEPS_A_ROUND // env.worlds.num_envs)

    def go() -> int:
        rollout.collect(agent.policy(), length)
        return length * env.worlds.num_envs

    return go
