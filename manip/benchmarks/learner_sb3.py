"""Stable-Baselines3 as it comes: its SAC.train and PPO.train, on filled buffers."""

from collections.abc import Callable

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import DummyVecEnv
from torch import nn

from manip.benchmarks.problem import GAMMA, Problem, transitions


class _Nothing(gymnasium.Env):
    """Spaces of the problem's sizes; nobody steps it."""

    def __init__(self, problem: Problem) -> None:
        self.observation_space = Box(-np.inf, np.inf, (problem.observation,))
        self.action_space = Box(-1.0, 1.0, (problem.action,))


def _worlds(problem: Problem) -> DummyVecEnv:
    return DummyVecEnv([lambda: _Nothing(problem)] * problem.worlds)


def sac(problem: Problem) -> Callable[[int], int]:
    """SAC.train: twin critics and the actor at every update, as SB3 always does."""
    learner = SAC(
        "MlpPolicy",
        _worlds(problem),
        gamma=GAMMA,
        batch_size=problem.batch,
        buffer_size=problem.stored,
        policy_kwargs={"net_arch": list(problem.hidden)},
        device="cpu",
    )
    learner.set_logger(configure(None, []))
    _fill(learner.replay_buffer, problem)

    def go(threads: int) -> int:
        torch.set_num_threads(threads)
        learner.train(problem.updates, problem.batch)
        return problem.updates

    return go


def _fill(buffer: object, problem: Problem) -> None:
    steps = problem.stored // problem.worlds
    found = transitions(problem, problem.worlds, steps)
    after = found["next"]
    infos: list[dict[str, object]] = [{}] * problem.worlds
    for t in range(steps):
        parts = (
            found["observation"][:, t],
            after["observation"][:, t],
            found["action"][:, t],
            after["reward"][:, t, 0],
            after["terminated"][:, t, 0],
        )
        buffer.add(*(part.numpy() for part in parts), infos)  # type: ignore[attr-defined]


def ppo(problem: Problem) -> Callable[[int], int]:
    """GAE and PPO.train, after the rollout's actions, values and log-probabilities."""
    learner = PPO(
        "MlpPolicy",
        _worlds(problem),
        gamma=GAMMA,
        n_steps=problem.length,
        batch_size=problem.minibatch,
        n_epochs=problem.epochs,
        policy_kwargs={"net_arch": list(problem.hidden), "activation_fn": nn.Tanh},
        device="cpu",
    )
    learner.set_logger(configure(None, []))
    found = transitions(problem, problem.length, problem.worlds)

    def go(threads: int) -> int:
        torch.set_num_threads(threads)
        _roll_out(learner, found)
        learner.train()
        return problem.epochs

    return go


@torch.no_grad()
def _roll_out(learner: PPO, found: object) -> None:
    """Fill the rollout buffer with what the policy would do now."""
    seen = found["observation"]  # type: ignore[index]
    rewards, ends = (
        found["next", key].squeeze(-1).numpy()  # type: ignore[index]
        for key in ("reward", "done")
    )
    actions, values, log_probs = learner.policy(seen.flatten(0, 1))
    length, worlds = seen.shape[:2]
    actions, values, log_probs = (
        part.view(length, worlds, -1) for part in (actions, values, log_probs)
    )
    buffer = learner.rollout_buffer
    buffer.reset()
    starts = np.ones(worlds)
    for t in range(length):
        buffer.add(
            seen[t].numpy(),
            actions[t].numpy(),
            rewards[t],
            starts,
            values[t],
            log_probs[t, :, 0],
        )
        starts = ends[t]
    buffer.compute_returns_and_advantage(values[-1], ends[-1])
