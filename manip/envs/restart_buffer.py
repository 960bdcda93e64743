"""RestartBuffer: visited states, from which later episodes start.

Episodes that begin near the goal show the learner states that a far start would reach
only with a good policy: releasing a cube on another, for example. (Restarts from past
states: Salimans and Chen 2018, arXiv 1812.03381, from a demonstration; Ecoffet et al.
2021, arXiv 2004.12919, from the agent's own.)
"""

from typing import Any

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.option_checks import state_array
from manip.errors import UserError
from manip.sim.engine import Snapshot

Array = np.ndarray

CAPACITY = 400
"""States stored per milestone, the latest ones (measured on Stack and PickPlaceCan)."""
INTERVAL = 7
"""Control steps between two states stored from one environment."""


class RestartBuffer:
    """The latest states of every milestone of a task but the last, its success.

    A state is stored under the last milestone that it has reached.

    Args:
        milestones: number of the task's milestones.
        like: a snapshot of environments like those whose states are stored.
    """

    def __init__(self, milestones: int, like: Snapshot) -> None:
        rows = (milestones - 1, CAPACITY)
        self._states = np.zeros((*rows, like.states.shape[1]))
        self._readings = np.zeros((*rows, like.readings.shape[1]))
        self._count = np.zeros(milestones - 1, np.int64)

    def store(self, snapshot: Snapshot, reached: Array) -> None:
        """Store states of a snapshot of n, by the milestones [n, M] they have reached.

        States that have reached none, or the last, are left out.
        """
        last = reached.shape[1] - 1 - np.argmax(reached[:, ::-1], axis=1)
        useful = reached.any(1) & ~reached[:, -1]
        for row in np.flatnonzero(useful):
            milestone = last[row]
            slot = self._count[milestone] % CAPACITY
            self._states[milestone, slot] = snapshot.states[row]
            self._readings[milestone, slot] = snapshot.readings[row]
            self._count[milestone] += 1

    def draw(self, streams: EpisodeStreams) -> Snapshot:
        """One state per stream: a milestone, then one of its states, uniformly."""
        reached = np.flatnonzero(self._count)
        unit = streams.uniform(0, 1, 2)
        milestone = reached[(unit[:, 0] * len(reached)).astype(np.int64)]
        stored = np.minimum(self._count[milestone], CAPACITY)
        slot = (unit[:, 1] * stored).astype(np.int64)
        return Snapshot(self._states[milestone, slot], self._readings[milestone, slot])

    @property
    def empty(self) -> bool:
        """Whether no state has been stored."""
        return not self._count.any()

    def save_state(self) -> dict[str, Any]:
        """Everything that `draw` depends on."""
        return {
            "states": self._states.copy(),
            "readings": self._readings.copy(),
            "count": self._count.copy(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned.

        Raises:
            UserError: it is of a buffer of other shapes.
        """
        states = state_array(state, "states", self._states)
        readings = state_array(state, "readings", self._readings)
        count = state_array(state, "count", self._count)
        if (count < 0).any():
            raise UserError("count of the saved restart buffer is negative")
        self._states[:], self._readings[:] = states, readings
        self._count[:] = count
