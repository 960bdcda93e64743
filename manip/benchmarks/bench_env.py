"""Speed of environments and of a collect loop, as a fraction of the engine's."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from manip.agents.sac import SACConfig
from manip.benchmarks.engine_steps import (
    engine_at_start,
    repeated_steps,
    scene_of,
    steps_per_env,
)
from manip.benchmarks.rounds import Comparison, Settings, speed
from manip.cpus import usable_cpus
from manip.envs.adapters.gymnasium import TaskVectorEnv
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.make_batch import make_batch
from manip.sim.scene import Scene
from manip.training.build import build_agent
from manip.training.collector import Rollout
from manip.training.recipes import recipe

TORCHRL = "TorchRL environment"
GYMNASIUM = "Gymnasium vector environment"
COLLECT = "collect loop with SAC policy"


def comparison(settings: Settings) -> Comparison:
    """Compare engine, environments (observe, reward, reset) and a SAC collect loop."""
    torch.set_num_threads(1)  # as in training: torch's idle threads busy-wait
    task, num_envs, scene = settings.task, settings.num_envs, scene_of(settings.task)
    engine = engine_at_start(task, scene, num_envs, usable_cpus())
    return Comparison(
        f"{task}, {num_envs} environments, {usable_cpus()} threads",
        {
            "engine": speed(repeated_steps(engine)),
            TORCHRL: speed(random_steps(_env(settings, scene))),
            GYMNASIUM: speed(_vector_steps(settings, scene)),
            COLLECT: speed(_collect(_env(settings, scene), task)),
        },
        ratios={
            "env_vs_engine": (TORCHRL, "engine"),
            "gymnasium_vs_engine": (GYMNASIUM, "engine"),
            "collect_vs_engine": (COLLECT, "engine"),
        },
    )


def _env(settings: Settings, scene: Scene) -> TaskEnv:
    batch = make_batch(settings.task, settings.num_envs, scene=scene, stagger=True)
    return TaskEnv(batch)


def random_steps(env: TaskEnv) -> Callable[[], int]:
    """Make a function that resets an environment and takes a round of random steps."""
    num_envs = env.batch_size[0]
    steps = steps_per_env(num_envs)

    def run() -> int:
        state = env.reset()
        for _ in range(steps):
            state["action"] = torch.rand(env.action_spec.shape) * 2 - 1
            _, state = env.step_and_maybe_reset(state)
        return steps * num_envs

    return run


def _vector_steps(settings: Settings, scene: Scene) -> Callable[[], int]:
    envs = TaskVectorEnv(settings.task, settings.num_envs, scene=scene, stagger=True)
    steps = steps_per_env(envs.num_envs)
    rng, shape = np.random.default_rng(0), envs.action_space.shape

    def run() -> int:
        envs.reset()
        for _ in range(steps):
            envs.step(rng.uniform(-1, 1, shape))
        return steps * envs.num_envs

    return run


def _collect(env: TaskEnv, task: str) -> Callable[[], int]:
    """Collect with an untrained actor; episodes continue from round to round."""
    config = recipe(task, "sac")
    assert isinstance(config.agent, SACConfig)
    acting = replace(config.agent, random_steps=0)
    agent = build_agent(replace(config, agent=acting), env)
    rollout, num_envs = Rollout(env), env.batch_size[0]
    length = steps_per_env(num_envs)

    def run() -> int:
        rollout.collect(agent.policy(), length)
        return length * num_envs

    return run
