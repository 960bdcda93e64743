"""What happened in an episode: milestones, reward terms, motion of the robot."""

from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDictBase

from manip.envs.adapters.torchrl import TaskEnv
from manip.evaluation.motion import Motion, MotionTracker

Array = np.ndarray


@dataclass(frozen=True)
class EpisodeDetails:
    """Details of one episode.

    Attributes:
        milestone_steps: first step of each milestone, from 1; None if not reached.
        reward_terms: sum over the episode of weight * term, for each term.
        motion: of the robot; None if the backend does not read it.
    """

    milestone_steps: tuple[int | None, ...]
    reward_terms: tuple[float, ...]
    motion: Motion | None = None


class DetailTracker:
    """Accumulate the details of the episodes of an environment.

    Args:
        env: N environments; the motion is that of their key `motion`, if there is one.
    """

    def __init__(self, env: TaskEnv) -> None:
        num_envs, batch = env.batch.num_envs, env.batch
        motion = "motion" in env.observation_spec.keys()
        self._weights = np.array([batch.reward_weights[n] for n in batch.reward_names])
        self._terms = np.zeros((num_envs, len(self._weights)))
        self._steps = np.zeros(num_envs, int)
        self._first = np.zeros((num_envs, len(batch.task.milestone_names)), int)
        self._motion = MotionTracker(num_envs, batch.control_dt) if motion else None

    def update(self, action: torch.Tensor, after: TensorDictBase) -> None:
        """Add a step: actions [N, A], and its `next` entry."""
        self._steps += 1
        self._terms += self._weights * after["reward_terms"].numpy()
        new = after["milestones"].numpy() & (self._first == 0)
        self._first = np.where(new, self._steps[:, None], self._first)
        if self._motion:
            motion = {name: rows.numpy() for name, rows in after["motion"].items()}
            self._motion.update(action.numpy(), motion)

    def finish(self, env_id: int) -> EpisodeDetails:
        """The details of an environment's episode, which has ended."""
        details = EpisodeDetails(
            milestone_steps=tuple(int(s) or None for s in self._first[env_id]),
            reward_terms=tuple(map(float, self._terms[env_id])),
            motion=self._motion.finish(env_id) if self._motion else None,
        )
        self._steps[env_id] = self._first[env_id] = 0
        self._terms[env_id] = 0.0
        return details
