"""The problem that all learners of the benchmark solve: sizes and random data."""

from dataclasses import dataclass

import torch
from tensordict import TensorDict

GAMMA = 0.97
"""Discount per control step, of every learner."""

END_FRACTION = 1 / 80
"""Fraction of steps that end an episode."""


@dataclass(frozen=True)
class Problem:
    """Sizes that all candidates share.

    Attributes:
        observation, action: widths of both vectors (those of Lift).
        hidden: widths of the hidden layers of actor and critics.
        batch: transitions of a SAC update.
        stored: transitions in SAC's buffer.
        updates: SAC updates per round.
        num_envs, length: N and T of a PPO rollout.
        minibatch: steps of a PPO update.
        epochs: passes of PPO over its rollout.
    """

    hidden: tuple[int, ...]
    observation: int = 44
    action: int = 7
    batch: int = 256
    stored: int = 65_536
    updates: int = 64
    num_envs: int = 64
    length: int = 64
    minibatch: int = 512
    epochs: int = 5

    @property
    def rows(self) -> int:
        """Steps of a PPO rollout."""
        return self.num_envs * self.length

    @property
    def stored_length(self) -> int:
        """Steps per environment that fill SAC's buffer."""
        return self.stored // self.num_envs


def transitions(problem: Problem, num_envs: int, length: int) -> TensorDict:
    """Draw a random rollout [N, T].

    Observations are normal, N(0, 1); actions are uniform in [-1, 1], rewards in [0, 1].
    """
    shape = (num_envs, length)
    after = _after(problem, shape)
    return TensorDict(
        {
            "observation": torch.randn(*shape, problem.observation),
            "action": torch.rand(*shape, problem.action) * 2 - 1,
            "next": TensorDict(after, shape),
        },
        shape,
    )


def _after(problem: Problem, shape: tuple[int, int]) -> dict[str, torch.Tensor]:
    """The result of each step; episodes end at their time limit only."""
    ended = torch.rand(*shape, 1) < END_FRACTION
    return {
        "observation": torch.randn(*shape, problem.observation),
        "reward": torch.rand(*shape, 1),
        "terminated": torch.zeros_like(ended),
        "truncated": ended,
        "done": ended,
    }
