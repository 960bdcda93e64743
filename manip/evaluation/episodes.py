"""Whole episodes, followed step by step in a batch of worlds."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

HELD_STEPS = 10
"""An episode's success is held if it is true in its last ten control steps."""

Policy = Callable[[Tensor], Tensor]
"""Observation [N, D] -> action [N, A]."""


@dataclass(frozen=True)
class Episode:
    """What became of one episode.

    success_once, success_at_end, held: whether success was true ever, at the last step, and in the
    last ten steps. milestones: whether each milestone was ever reached. first_success:
    the step of the first success, counted from 1, if any.
    """

    world: int
    steps: int
    total_reward: float
    success_once: bool
    success_at_end: bool
    success_held: bool
    first_success: int | None
    milestones: tuple[bool, ...]


class EpisodeTracker:
    """Follows N worlds and reports the episodes that end."""

    def __init__(self, num_envs: int) -> None:
        self._steps = torch.zeros(num_envs, dtype=torch.int64)
        self._reward = torch.zeros(num_envs)
        self._streak = torch.zeros(num_envs, dtype=torch.int64)
        self._first = torch.zeros(num_envs, dtype=torch.int64)
        self._stages: Tensor | None = None

    def update(self, after: TensorDictBase) -> list[Episode]:
        """Take in the `next` entry [N] of a step; the episodes that ended with it."""
        success, done = after["success"].squeeze(-1), after["done"].squeeze(-1)
        self._steps += 1
        self._reward += after["reward"].squeeze(-1)
        self._streak = torch.where(success, self._streak + 1, 0)
        self._first = torch.where(
            success & (self._first == 0), self._steps, self._first
        )
        milestones = after["milestones"]
        self._stages = milestones if self._stages is None else self._stages | milestones
        ended = torch.nonzero(done).squeeze(-1).tolist()
        episodes = [self._episode(world) for world in ended]
        for world in ended:
            self._forget(world)
        return episodes

    def save_state(self) -> dict[str, Any]:
        """What is known of the episodes under way."""
        counters = [counter.clone() for counter in self._counters()]
        return {"counters": counters, "milestones": self._stages}

    def load_state(self, state: dict[str, Any]) -> None:
        """Put back what `save_state` gave."""
        for counter, saved in zip(self._counters(), state["counters"], strict=True):
            counter.copy_(saved)
        self._stages = state["milestones"]

    def _counters(self) -> tuple[Tensor, ...]:
        return self._steps, self._reward, self._streak, self._first

    def _episode(self, world: int) -> Episode:
        assert self._stages is not None
        first, streak = int(self._first[world]), int(self._streak[world])
        return Episode(
            world=world,
            steps=int(self._steps[world]),
            total_reward=float(self._reward[world]),
            success_once=first > 0,
            success_at_end=streak > 0,
            success_held=streak >= HELD_STEPS,
            first_success=first or None,
            milestones=tuple(self._stages[world].tolist()),
        )

    def _forget(self, world: int) -> None:
        for counter in self._counters():
            counter[world] = 0
        if self._stages is not None:
            self._stages = self._stages.clone()
            self._stages[world] = False


@torch.no_grad()
def run_episodes(
    env: EnvBase,
    policy: Policy,
    episodes: int,
    watch: Callable[[TensorDictBase], None] | None = None,
) -> list[Episode]:
    """Run an exact number of episodes, split evenly over the worlds in advance.

    A static split does not favour short episodes, as taking the first to finish
    would.

    Args:
        env: with N worlds; `episodes` must be a multiple of N.
        policy: the action of each observation.
        watch: called with the worlds' state before every step, and at the end.
    """
    worlds = env.batch_size[0]
    if episodes % worlds:
        raise ValueError(f"{episodes} episodes do not split over {worlds} worlds")
    owed = torch.full((worlds,), episodes // worlds)
    tracker, finished = EpisodeTracker(worlds), []
    state = env.reset()
    while owed.any():
        if watch:
            watch(state)
        state["action"] = policy(state["observation"])
        step, state = env.step_and_maybe_reset(state)
        for episode in tracker.update(step["next"]):
            if owed[episode.world]:
                owed[episode.world] -= 1
                finished.append(episode)
    return finished
