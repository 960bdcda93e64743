"""Stable-Baselines3's own SAC.train and PPO.train, on filled buffers."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import DummyVecEnv
from torch import nn

from manip.benchmarks.learner_problem import GAMMA, Problem, transitions


class _SpacesOnly(gymnasium.Env):
    """An environment that is never stepped: it has the problem's spaces."""

    def __init__(self, problem: Problem) -> None:
        self.observation_space = Box(-np.inf, np.inf, (problem.observation,))
        self.action_space = Box(-1.0, 1.0, (problem.action,))


def _envs(problem: Problem) -> DummyVecEnv:
    return DummyVecEnv([lambda: _SpacesOnly(problem)] * problem.num_envs)


def sac(problem: Problem) -> Callable[[int], int]:
    """SAC.train, which updates twin critics and the actor at every update."""
    learner = SAC(
        "MlpPolicy",
        _envs(problem),
        gamma=GAMMA,
        batch_size=problem.batch,
        buffer_size=problem.stored,
        policy_kwargs={"net_arch": list(problem.hidden)},
        device="cpu",
    )
    learner.set_logger(configure(None, []))
    _fill(learner.replay_buffer, problem)

    def run(threads: int) -> int:
        torch.set_num_threads(threads)
        learner.train(problem.updates, problem.batch)
        return problem.updates

    return run


def _fill(buffer: Any, problem: Problem) -> None:
    batch = transitions(problem, problem.num_envs, problem.stored_length)
    after = batch["next"]
    infos: list[dict[str, object]] = [{}] * problem.num_envs
    for t in range(problem.stored_length):
        parts = (
            batch["observation"][:, t],
            after["observation"][:, t],
            batch["action"][:, t],
            after["reward"][:, t, 0],
            after["terminated"][:, t, 0],
        )
        buffer.add(*(part.numpy() for part in parts), infos)


def ppo(problem: Problem) -> Callable[[int], int]:
    """PPO.train, after the rollout's actions, values, log-probabilities and GAE."""
    learner = PPO(
        "MlpPolicy",
        _envs(problem),
        gamma=GAMMA,
        n_steps=problem.length,
        batch_size=problem.minibatch,
        n_epochs=problem.epochs,
        policy_kwargs={"net_arch": list(problem.hidden), "activation_fn": nn.Tanh},
        device="cpu",
    )
    learner.set_logger(configure(None, []))
    rollout = transitions(problem, problem.length, problem.num_envs)

    def run(threads: int) -> int:
        torch.set_num_threads(threads)
        _fill_rollout(learner, rollout)
        learner.train()
        return problem.epochs

    return run


@torch.no_grad()
def _fill_rollout(learner: PPO, rollout: Any) -> None:
    """Fill the rollout buffer with the current policy's actions and values."""
    observations = rollout["observation"]
    rewards, ends = (
        rollout["next", key].squeeze(-1).numpy() for key in ("reward", "done")
    )
    shape = observations.shape[:2]
    outputs = learner.policy(observations.flatten(0, 1))
    actions, values, log_probs = (part.view(*shape, -1) for part in outputs)
    buffer = learner.rollout_buffer
    buffer.reset()
    starts = np.ones(shape[1])
    for t in range(shape[0]):
        step = observations[t].numpy(), actions[t].numpy(), rewards[t], starts
        buffer.add(*step, values[t], log_probs[t, :, 0])
        starts = ends[t]
    buffer.compute_returns_and_advantage(values[-1], ends[-1])
