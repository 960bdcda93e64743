"""What all learners of the benchmark are given: sizes, and random experience."""

from dataclasses import dataclass

import torch
from tensordict import TensorDict

GAMMA = 0.97
"""Discount a control step, of every learner."""

ENDS = 1 / 80
"""Share of steps that end an episode."""


@dataclass(frozen=True)
class Problem:
    """Sizes that all contestants share.

    Attributes:
        observation, action: widths of both vectors (those of Lift).
        hidden: widths of the hidden layers of actor and critics.
        batch: transitions of a SAC update.
        stored: transitions in SAC's buffer.
        updates: SAC updates a round.
        worlds, length: N and T of a PPO rollout.
        minibatch: steps of a PPO update.
        epochs: passes of PPO over its rollout.
    """

    hidden: tuple[int, ...]
    observation: int = 44
    action: int = 7
    batch: int = 256
    stored: int = 65_536
    updates: int = 64
    worlds: int = 64
    length: int = 64
    minibatch: int = 512
    epochs: int = 5

    @property
    def rows(self) -> int:
        """Steps of a PPO rollout."""
        return self.worlds * self.length


def transitions(problem: Problem, worlds: int, length: int) -> TensorDict:
    """A random rollout [N, T]: observations ~ N(0, 1), actions uniform, rewards too."""
    shape = (worlds, length)
    ended = torch.rand(*shape, 1) < ENDS
    following = {
        "observation": torch.randn(*shape, problem.observation),
        "reward": torch.rand(*shape, 1),
        "terminated": torch.zeros_like(ended),
        "truncated": ended,
        "done": ended,
    }
    return TensorDict(
        {
            "observation": torch.randn(*shape, problem.observation),
            "action": torch.rand(*shape, problem.action) * 2 - 1,
            "next": TensorDict(following, shape),
        },
        shape,
    )
