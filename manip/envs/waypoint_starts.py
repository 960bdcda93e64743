"""Start episodes from the states of a task's waypoints, by a curriculum.

A waypoint is needed as long as the policy does not succeed from it:

    need(w) = max(1 - success(w), LEAST),   share = fraction * mean of need over all w

`share` of the episodes start from a waypoint, drawn in proportion to its need; the
others start as without waypoints. So the end of a task is practised first, and the
episodes shift to the true starts as success rises. (Reverse curricula: Florensa et al.
2017, arXiv 1707.05300, which find the starts by random actions from the goal; here a
task describes them.)
"""

from typing import Any, NamedTuple

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.option_checks import check_share, state_array
from manip.errors import UserError
from manip.sim.engine import Engine, Snapshot

Array = np.ndarray

FAMILY = 1
"""Family of the random streams that draw waypoints."""
RATE = 0.05
"""Weight of an episode in the running success rates."""
LEAST = 0.1
"""Need of a mastered waypoint: it is not forgotten."""
NONE = -1
"""Number of the waypoint of episodes that start from none."""


class WaypointStates(NamedTuple):
    """States of W waypoints, K of each.

    names [W]; states [W, K, S] and readings [W, K, R], as in `Snapshot`.
    """

    names: tuple[str, ...]
    states: Array
    readings: Array


class WaypointStarts:
    """Draw starts of N environments from waypoints, and follow the success.

    Args:
        waypoints: their states.
        fraction: share of the episodes that start from one at first.
        num_envs: N.

    Attributes:
        fraction: as given.
        success: [W] running rates of success at the end of the episodes from each
            waypoint.
    """

    def __init__(
        self, waypoints: WaypointStates, fraction: float, num_envs: int
    ) -> None:
        check_share("waypoint_fraction", fraction)
        self.fraction = fraction
        self.success = np.zeros(len(waypoints.names))
        self._waypoints = waypoints
        self._begun_at = np.full(num_envs, NONE)

    @property
    def share(self) -> float:
        """Present share of the episodes that start from a waypoint."""
        return float(self.fraction * self._need().mean())

    def begin(self, engine: Engine, env_ids: Array, streams: EpisodeStreams) -> None:
        """Put some of the environments that begin an episode into waypoint states.

        Args:
            engine: of the environments.
            env_ids: [n].
            streams: n streams of the family `FAMILY`.
        """
        unit = streams.uniform(0, 1, 3)
        chosen = unit[:, 0] < self.share
        waypoint = np.searchsorted(self._chances(), unit[:, 1], side="right")
        slot = (unit[:, 2] * self._waypoints.states.shape[1]).astype(np.int64)
        self._begun_at[env_ids] = np.where(chosen, waypoint, NONE)
        which = waypoint[chosen], slot[chosen]
        states, readings = self._waypoints.states, self._waypoints.readings
        engine.restore(Snapshot(states[which], readings[which]), env_ids[chosen])

    def end(self, done: Array, success: Array) -> None:
        """Count the episodes [N] that are done, and whether they end in success."""
        for env_id in np.flatnonzero(done & (self._begun_at != NONE)):
            waypoint = self._begun_at[env_id]
            self.success[waypoint] += RATE * (success[env_id] - self.success[waypoint])

    def _need(self) -> Array:
        """[W]: how much each waypoint is needed."""
        return np.maximum(1 - self.success, LEAST)

    def _chances(self) -> Array:
        """[W] cumulative chances of the waypoints; the last one is above 1."""
        need = self._need()
        chances = np.cumsum(need / need.sum())
        chances[-1] = 2.0  # no rounding below 1
        return chances

    def save_state(self) -> dict[str, Any]:
        """Everything that later starts depend on, the states included."""
        return {
            "waypoint_states": self._waypoints.states.copy(),
            "waypoint_readings": self._waypoints.readings.copy(),
            "waypoint_success": self.success.copy(),
            "waypoint_begun_at": self._begun_at.copy(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned.

        Raises:
            UserError: it is of other waypoints or environments.
        """
        now = self.save_state()
        saved = {name: state_array(state, name, like) for name, like in now.items()}
        begun_at, success = saved["waypoint_begun_at"], saved["waypoint_success"]
        if (begun_at < NONE).any() or (begun_at >= len(self.success)).any():
            raise UserError("waypoint_begun_at of the saved state names no waypoint")
        if not ((success >= 0) & (success <= 1)).all():
            raise UserError("waypoint_success of the saved state is not from 0 to 1")
        states, readings = saved["waypoint_states"], saved["waypoint_readings"]
        self._waypoints = self._waypoints._replace(states=states, readings=readings)
        self.success[:], self._begun_at[:] = success, begun_at
