"""Tasks that move one free body to its place, alone or as one of several."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Start, Task, Waypoint
from manip.sim.scene import Scene

Array = np.ndarray


class ObjectTask(Task):
    """Move one free body to its place.

    Attributes:
        body: name of the free body.
    """

    body: ClassVar[str]

    @abstractmethod
    def place_in_hand(
        self, milestone: str, scene: Scene, streams: EpisodeStreams, start: Start
    ) -> Waypoint:
        """Put the body, which is at its start, into the hand at a milestone."""

    @abstractmethod
    def sample_rest(self, streams: EpisodeStreams) -> Array:
        """[n, 7]: qpos of the body at rest in its place."""

    def sample_waypoint(
        self, milestone: str, scene: Scene, streams: EpisodeStreams
    ) -> Waypoint:
        """The body in the hand; all else is at its start."""
        start = self.sample_start(scene, streams)
        return self.place_in_hand(milestone, scene, streams, start)
