"""Averages over recent training episodes and rollouts."""

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from manip.evaluation.episodes import Episode
from manip.evaluation.report import SUCCESS

RECENT_EPISODES = 100
"""Finished training episodes that are averaged over."""

RECENT_ROLLOUTS = 20
"""Rollouts whose reward terms are averaged over."""


class TrainingAverages:
    """Compute the `train/` columns of metrics.csv.

    Args:
        milestones: names of the task's milestones.
        weights: reward term -> weight, in the order of a rollout's terms.
    """

    def __init__(self, milestones: Sequence[str], weights: Mapping[str, float]) -> None:
        self._milestones, self._weights = milestones, weights
        self.episodes: deque[Episode] = deque(maxlen=RECENT_EPISODES)
        self.terms: deque[list[float]] = deque(maxlen=RECENT_ROLLOUTS)

    def add(self, episodes: Sequence[Episode], terms: list[float]) -> None:
        """Add a rollout: finished episodes, and the mean of each raw reward term."""
        self.episodes.extend(episodes)
        self.terms.append(terms)

    def values(self) -> dict[str, float]:
        """Column name -> average; empty before the first episode has finished."""
        return self.of_episodes() | self._of_terms() if self.episodes else {}

    def of_episodes(self) -> dict[str, float]:
        """The columns of episodes alone; empty before the first has finished."""
        if not self.episodes:
            return {}
        milestones = np.mean([episode.milestones for episode in self.episodes], axis=0)
        return {
            "train/return": float(np.mean([e.total_reward for e in self.episodes])),
            **{f"train/{kind}": self._share(kind) for kind in SUCCESS},
            **{
                f"train/{name}": float(share)
                for name, share in zip(self._milestones, milestones, strict=True)
            },
        }

    def _share(self, kind: str) -> float:
        """Share of the episodes with a kind of success."""
        return float(np.mean([getattr(e, kind) for e in self.episodes]))

    def _of_terms(self) -> dict[str, float]:
        """Mean contribution of each term to a step's reward: weight * term."""
        means = np.mean(self.terms, axis=0)
        return {
            f"train/reward/{name}": weight * float(mean)
            for (name, weight), mean in zip(self._weights.items(), means, strict=True)
        }
