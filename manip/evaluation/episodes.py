"""Run whole episodes, and record the outcome of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from manip.evaluation.episode_details import DetailTracker, EpisodeDetails

Array = np.ndarray

HELD_STEPS = 10
"""`success_held`: success in each of the last ten control steps of an episode."""

Policy = Callable[[Mapping[str, Tensor]], Tensor]
"""Observation parts, name -> [N, ...], to action [N, A]."""

Penalty = Callable[[Array], Array]
"""Visible measures [N, M] of a step, to penalties [N]."""

Callback = Callable[[TensorDictBase], None]
"""Gets the state [N] of the environments."""


@dataclass(frozen=True)
class Episode:
    """Outcome of one episode.

    Attributes:
        env_id: index of the environment that ran it.
        steps: control steps.
        total_reward: undiscounted sum of rewards.
        success_once: success was true in at least one step.
        success_at_end: success was true in the last step.
        success_held: success was true in the last `HELD_STEPS` steps.
        first_success: step of the first success, counted from 1; None without any.
        milestones: for each milestone, whether it was true in at least one step.
        penalty: mean penalty of a step; None if nothing was penalised.
        index: number of the episode among those of `run_episodes`.
        details: see `EpisodeDetails`; None if they were not requested.
    """

    env_id: int
    steps: int
    total_reward: float
    success_once: bool
    success_at_end: bool
    success_held: bool
    first_success: int | None
    milestones: tuple[bool, ...]
    penalty: float | None = None
    index: int = 0
    details: EpisodeDetails | None = None


class EpisodeTracker:
    """Accumulate the steps of N environments, and report the episodes that end.

    Args:
        num_envs: N.
        penalty: penalises steps by their measures.
    """

    def __init__(self, num_envs: int, penalty: Penalty | None = None) -> None:
        self._penalty = penalty
        self._penalties = torch.zeros(num_envs, dtype=torch.float64)
        self._steps = torch.zeros(num_envs, dtype=torch.int64)
        self._reward = torch.zeros(num_envs)
        self._streak = torch.zeros(num_envs, dtype=torch.int64)
        self._first = torch.zeros(num_envs, dtype=torch.int64)
        self._milestones = torch.zeros(num_envs, 0, dtype=torch.bool)

    def update(self, after: TensorDictBase) -> list[Episode]:
        """Add the `next` entry [N] of a step; return the episodes that it ended."""
        success, done, reward = (
            after[key].squeeze(-1).cpu() for key in ("success", "done", "reward")
        )
        self._steps += 1
        self._reward += reward
        self._streak = torch.where(success, self._streak + 1, 0)
        self._first = torch.where(
            success & (self._first == 0), self._steps, self._first
        )
        self._add_milestones(after["milestones"].cpu())
        if self._penalty:
            penalties = self._penalty(after["measures"].numpy())
            self._penalties += torch.from_numpy(penalties)
        return self._end(torch.nonzero(done).squeeze(-1).tolist())

    def save_state(self) -> dict[str, Any]:
        """Copy the accumulated values of the episodes under way."""
        counters = [counter.clone() for counter in self._counters()]
        stepped = self._milestones.shape[1] > 0
        milestones = self._milestones.clone() if stepped else None
        return {"counters": counters, "milestones": milestones}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned.

        Raises:
            ValueError: the state is of another number of environments.
        """
        for counter, saved in zip(self._counters(), state["counters"], strict=True):
            if counter.shape != saved.shape:
                raise ValueError(
                    f"saved of {len(saved)} environments, not {len(counter)}"
                )
            counter.copy_(saved)
        self._milestones = torch.zeros(len(self._steps), 0, dtype=torch.bool)
        if state["milestones"] is not None:  # None: saved before the first step
            self._add_milestones(state["milestones"])

    def _end(self, env_ids: list[int]) -> list[Episode]:
        """The episodes that have ended; their environments begin others."""
        episodes = [self._episode(env_id) for env_id in env_ids]
        if episodes:
            for entries in (*self._counters(), self._milestones, self._penalties):
                entries[env_ids] = 0
        return episodes

    def _add_milestones(self, milestones: Tensor) -> None:
        if len(milestones) != len(self._steps):
            raise ValueError(f"milestones of {len(milestones)} environments")
        if self._milestones.shape != milestones.shape:
            self._milestones = torch.zeros_like(milestones)
        self._milestones = self._milestones | milestones

    def _counters(self) -> tuple[Tensor, ...]:
        return self._steps, self._reward, self._streak, self._first

    def _episode(self, env_id: int) -> Episode:
        first, streak = int(self._first[env_id]), int(self._streak[env_id])
        penalty = float(self._penalties[env_id] / self._steps[env_id])
        return Episode(
            env_id=env_id,
            steps=int(self._steps[env_id]),
            total_reward=float(self._reward[env_id]),
            success_once=first > 0,
            success_at_end=streak > 0,
            success_held=streak >= HELD_STEPS,
            first_success=first or None,
            milestones=tuple(self._milestones[env_id].tolist()),
            penalty=penalty if self._penalty else None,
        )


@torch.no_grad()
def run_episodes(
    env: EnvBase,
    policy: Policy,
    episodes: int,
    callback: Callback | None = None,
    penalty: Penalty | None = None,
    details: DetailTracker | None = None,
) -> list[Episode]:
    """Run an exact number of episodes, the same number in each environment.

    To take the first episodes that finish instead would favour short ones.

    Args:
        env: N environments, with `env.parts(state)` (see TaskEnv).
        policy: returns the actions for the observation parts.
        episodes: a multiple of N.
        callback: called with the state before every step.
        penalty: penalises the steps of an environment that gives its measures.
        details: accumulates the details of the episodes.

    Raises:
        ValueError: `episodes` is no multiple of N.
    """
    num_envs = env.batch_size[0]
    if episodes % num_envs:
        raise ValueError(
            f"{episodes} episodes cannot be shared evenly by {num_envs} environments"
        )
    missing = torch.full((num_envs,), episodes // num_envs)
    tracker, finished = EpisodeTracker(num_envs, penalty), []
    state = env.reset()
    while missing.any():
        if callback:
            callback(state)
        state["action"] = policy(env.parts(state))
        step, state = env.step_and_maybe_reset(state)
        if details:
            details.update(step["action"], step["next"])
        for episode in tracker.update(step["next"]):
            more = details.finish(episode.env_id) if details else None
            if missing[episode.env_id]:
                missing[episode.env_id] -= 1
                earlier = episodes // num_envs - 1 - int(missing[episode.env_id])
                index = episode.env_id + num_envs * earlier
                finished.append(replace(episode, index=index, details=more))
    return finished
