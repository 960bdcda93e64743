"""Stable-Baselines3's SAC on stock robosuite, through Gymnasium."""

import time
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import gymnasium
import torch
from gymnasium.wrappers import TimeLimit
from rich.console import Console
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from torch import Tensor, nn

from manip.benchmarks.time_to_success import GOAL, TimedRun, held_in_stock
from manip.envs.adapters.gymnasium import TaskEnv
from manip.evaluation.statistics import Rate
from manip.robot_config import RobotConfig

NAME = "SB3 SAC"

HORIZON = 500
"""Control steps of a training episode, as in robosuite's published benchmark."""

OPTIONS: dict[str, Any] = {
    "batch_size": 128,
    "buffer_size": 1_000_000,
    "learning_starts": 3_300,
    "learning_rate": 5e-4,
    "gamma": 0.99,
    "tau": 0.005,
    "target_update_interval": 5,
    "train_freq": 25,
    "gradient_steps": 10,
    "policy_kwargs": {"net_arch": [256, 256]},
}
"""Options of SAC in robosuite's benchmark (ARISE-Initiative/robosuite-benchmark,
variant.json), with 0.4 updates per step; the others are SB3's defaults. There the
actor's learning rate is 1e-3; SB3 has one for all networks."""

EVALUATIONS = 12
"""Evaluations of a run that uses all of its time."""


def stock_env(task: str) -> gymnasium.Env:
    """Stock robosuite with its own shaped reward and manip's observation."""
    return TimeLimit(TaskEnv(task, backend="stock", reward="stock"), HORIZON)


def learn(task: str, seed: int, limit: float, episodes: int) -> TimedRun:
    """Train until an evaluation reaches the goal, or for `limit` seconds."""
    env = stock_env(task)
    names = tuple(env.get_wrapper_attr("batch").observation_spec.slices)
    evaluation = _Evaluation(task, names, limit, episodes)
    learner = SAC("MlpPolicy", env, seed=seed, device="cpu", **OPTIONS)
    learner.learn(2**62, callback=evaluation, log_interval=None)
    assert evaluation.rate is not None
    steps = learner.num_timesteps
    return TimedRun(NAME, seed, evaluation.seconds, steps, evaluation.rate)


class _MeanActor(nn.Module):
    """A copy of SB3's actor without noise: observation parts -> action [N, A]."""

    def __init__(self, actor: Any, names: tuple[str, ...]) -> None:
        super().__init__()
        self._net = deepcopy(nn.Sequential(actor.latent_pi, actor.mu, nn.Tanh()))
        self._names = names

    def forward(self, parts: Mapping[str, Tensor]) -> Tensor:
        joined = torch.cat([parts[name].flatten(1) for name in self._names], 1)
        return self._net(joined)


class _Evaluation(BaseCallback):
    """Evaluates at regular times, with the clock stopped; ends the training.

    Attributes:
        rate: success_held of the latest evaluation.
    """

    rate: Rate | None = None

    def __init__(
        self, task: str, names: tuple[str, ...], limit: float, episodes: int
    ) -> None:
        super().__init__()
        self._task, self._names = task, names
        self._limit, self._episodes = limit, episodes
        self._interval = self._next = limit / EVALUATIONS
        self._start = time.monotonic()

    @property
    def seconds(self) -> float:
        """Wall time of training, without evaluations."""
        return time.monotonic() - self._start

    def _on_step(self) -> bool:
        if self.seconds < self._next:
            return True
        paused = time.monotonic()
        self.rate = self._evaluate()
        self._report(paused - self._start, self.rate)
        self._start += time.monotonic() - paused
        self._next += self._interval
        return self.rate.rate < GOAL and self.seconds < self._limit

    def _evaluate(self) -> Rate:
        policy = _MeanActor(self.model.policy.actor, self._names)
        return held_in_stock(self._task, policy, self._episodes, RobotConfig())

    def _report(self, seconds: float, rate: Rate) -> None:
        Console(stderr=True).print(
            f"step {self.num_timesteps:>9,}  {seconds:6.0f} s  "
            f"success_held {rate.rate:4.0%}",
            highlight=False,
        )
