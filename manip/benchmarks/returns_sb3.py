"""Stable-Baselines3's PPO and SAC on Pendulum-v1, with the same options."""

from collections.abc import Mapping
from typing import Any

from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv
from torch import nn

from manip.benchmarks.pendulum import NET, NUM_ENVS, STEPS, Act, pendulum

KINDS = {"PPO": PPO, "SAC": SAC}
OPTIONS: Mapping[str, dict[str, Any]] = {
    "PPO": {
        "gamma": 0.9,
        "learning_rate": 1e-3,
        "n_steps": 256,
        "n_epochs": 10,
        "batch_size": 64,
        "gae_lambda": 0.95,
        "clip_range": 0.2,
        "ent_coef": 0.0,
        "max_grad_norm": 0.5,
        "policy_kwargs": {
            "net_arch": [*NET],
            "activation_fn": nn.Tanh,
            "log_std_init": -0.5,
        },
    },
    "SAC": {
        "gamma": 0.99,
        "learning_rate": 1e-3,
        "train_freq": 1,
        "gradient_steps": 1,
        "tau": 0.005,
        "batch_size": 256,
        "learning_starts": 500,
        "ent_coef": "auto_1.0",
        "target_entropy": -1.0,
        "policy_kwargs": {"net_arch": [*NET]},
    },
}


def learn(algo: str, seed: int) -> Act:
    """Train for the algorithm's number of steps and return the policy."""
    envs = DummyVecEnv([pendulum] * NUM_ENVS[algo])
    learner = KINDS[algo]("MlpPolicy", envs, seed=seed, device="cpu", **OPTIONS[algo])
    learner.learn(STEPS[algo])
    return lambda observation: learner.predict(observation, deterministic=True)[0]
