"""Pendulum-v1: the environment, the budgets, and the evaluation of policies."""

from collections.abc import Callable

import gymnasium
import numpy as np
from gymnasium.vector import SyncVectorEnv
from gymnasium.wrappers import RescaleAction

Act = Callable[[np.ndarray], np.ndarray]
"""Policy: observations [N, 3] -> actions [N, 1] in [-1, 1]."""

HORIZON = 200
"""Control steps of an episode, Gymnasium's default."""

EPISODES = 100
"""Episodes of an evaluation."""

NET = (64, 64)
"""Hidden layers of actors and critics."""

STEPS = {"PPO": 30_000, "SAC": 3_000}
"""Algorithm -> control steps of training."""

NUM_ENVS = {"PPO": 8, "SAC": 1}
"""Algorithm -> number of training environments."""

EVALUATION_SEED = 1_000_000
"""Seed of the evaluation, far from the training seeds 0, 1, ..."""


def pendulum() -> gymnasium.Env:
    """Pendulum-v1 with its torque scaled to [-1, 1]."""
    return RescaleAction(gymnasium.make("Pendulum-v1"), np.float32(-1), np.float32(1))


def mean_return(act: Act) -> float:
    """Mean return of a policy; its episodes start alike for every policy."""
    envs = SyncVectorEnv([pendulum] * EPISODES)
    observation, _ = envs.reset(seed=EVALUATION_SEED)
    total = 0.0
    for _ in range(HORIZON):
        observation, reward, *_ = envs.step(act(observation))
        total += reward.mean()
    return total
