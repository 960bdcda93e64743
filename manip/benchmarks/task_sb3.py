"""Stable-Baselines3's SAC on stock robosuite, through Gymnasium."""

import time
from copy import deepcopy
from typing import Any

import gymnasium
from gymnasium.wrappers import TimeLimit
from rich.console import Console
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from manip.benchmarks.attempts import GOAL, Attempt, held_in_stock
from manip.envs.adapters.gymnasium import TaskEnv
from manip.evaluation.statistics import Rate
from manip.robot_config import RobotConfig

NAME = "SB3 SAC"

HORIZON = 500
"""Steps of a training episode, in robosuite's published benchmark."""

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
"""Those of robosuite's benchmark of SAC (ARISE-Initiative/robosuite-benchmark,
variant.json), 0.4 updates a step; the rest as SB3 has it. There the actor's step size
is 1e-3; SB3 has one for all networks."""

EVALUATIONS = 12
"""Evaluations in the time that is given."""


def stock_env(task: str) -> gymnasium.Env:
    """Stock robosuite with its own shaped reward, observed as our tasks observe it."""
    return TimeLimit(TaskEnv(task, env="stock", reward="stock"), HORIZON)


def learn(task: str, seed: int, cap: float, episodes: int) -> Attempt:
    """Learn until the goal is reached in an evaluation, or for `cap` seconds."""
    judge = _Judge(task, cap, episodes)
    learner = SAC("MlpPolicy", stock_env(task), seed=seed, device="cpu", **OPTIONS)
    learner.learn(2**62, callback=judge, log_interval=None)
    assert judge.success_held is not None
    return Attempt(NAME, seed, judge.seconds, learner.num_timesteps, judge.success_held)


class _Judge(BaseCallback):
    """Evaluates now and then, with the clock stopped; ends at the goal or the cap."""

    held: Rate | None = None

    def __init__(self, task: str, cap: float, episodes: int) -> None:
        super().__init__()
        self._task, self._cap, self._episodes = task, cap, episodes
        self._every = self._due = cap / EVALUATIONS
        self._began = time.monotonic()

    @property
    def seconds(self) -> float:
        """Wall time without evaluations."""
        return time.monotonic() - self._began

    def _on_step(self) -> bool:
        if self.seconds < self._due:
            return True
        stopped = time.monotonic()
        self.success_held = self._evaluate()
        self._say(stopped - self._began)
        self._began += time.monotonic() - stopped
        self._due += self._every
        return self.success_held.rate < GOAL and self.seconds < self._cap

    def _evaluate(self) -> Rate:
        actor = self.model.policy.actor
        policy = deepcopy(nn.Sequential(actor.latent_pi, actor.mu, nn.Tanh()))
        return held_in_stock(self._task, policy, self._episodes, RobotConfig())

    def _say(self, seconds: float) -> None:
        assert self.success_held is not None
        Console(stderr=True).print(
            f"step {self.num_timesteps:>9,}  {seconds:6.0f} s  "
            f"held {self.success_held.rate:4.0%}",
            highlight=False,
        )
