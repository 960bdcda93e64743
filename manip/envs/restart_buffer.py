"""States that an agent has reached before, as starts of later episodes.

Episodes that begin near the goal show the learner what a far start would show it only
once it is good: how to let go of a cube on another, say. (Restarts from past states:
Salimans and Chen 2018, arXiv 1812.03381, from a demonstration; Ecoffet et al. 2021,
arXiv 2004.12919, from the agent's own.)
"""

from typing import Any

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.sim.batch_engine import Snapshot

Array = np.ndarray

CAPACITY = 400
"""States kept for each stage, the latest ones (measured on Stack and PickPlaceCan)."""
EVERY = 7
"""Control steps between two looks at the same world."""


class RestartBuffer:
    """The latest states of every stage of a task but the last, its success.

    A state belongs to the last of the milestones that hold in it.

    Args:
        milestones: number of the task's milestones.
        like: a snapshot of worlds such as those that are kept.
    """

    def __init__(self, milestones: int, like: Snapshot) -> None:
        room = (milestones - 1, CAPACITY)
        self._states = np.zeros((*room, like.states.shape[1]))
        self._readings = np.zeros((*room, like.readings.shape[1]))
        self._kept = np.zeros(milestones - 1, np.int64)

    def keep(self, snapshot: Snapshot, reached: Array) -> None:
        """Keep worlds of a snapshot of n, by the milestones [n, M] that hold in them."""
        last = reached.shape[1] - 1 - np.argmax(reached[:, ::-1], axis=1)
        fit = reached.any(1) & ~reached[:, -1]
        for row in np.flatnonzero(fit):
            stage = last[row]
            at = self._kept[stage] % CAPACITY
            self._states[stage, at] = snapshot.states[row]
            self._readings[stage, at] = snapshot.readings[row]
            self._kept[stage] += 1

    def draw(self, streams: EpisodeStreams) -> Snapshot:
        """A state for each stream: any stage that was reached, then any state of it."""
        known = np.flatnonzero(self._kept)
        unit = streams.uniform(0, 1, 2)
        stage = known[(unit[:, 0] * len(known)).astype(np.int64)]
        held = np.minimum(self._kept[stage], CAPACITY)
        at = (unit[:, 1] * held).astype(np.int64)
        return Snapshot(self._states[stage, at], self._readings[stage, at])

    @property
    def empty(self) -> bool:
        """Whether no stage was reached so far."""
        return not self._kept.any()

    def save_state(self) -> dict[str, Any]:
        """Everything that `draw` depends on."""
        return {
            "states": self._states.copy(),
            "readings": self._readings.copy(),
            "kept": self._kept.copy(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Put back what `save_state` gave."""
        self._states[:] = state["states"]
        self._readings[:] = state["readings"]
        self._kept[:] = state["kept"]
