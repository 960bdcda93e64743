"""Start episodes from the states of a task's waypoints, by a curriculum.

The share of such episodes falls from `fraction` to 0 as the success rate from true
starts rises. Among them, a waypoint from which the policy often succeeds is drawn less
often. (Reverse curricula: Florensa et al. 2017, arXiv 1707.05300, which expands the
starts by random actions; here a task describes them.)
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
"""Chance of a mastered waypoint relative to one from which no episode succeeds."""
TRUE_START, OTHER = -1, -2
"""Numbers of episodes that start from no waypoint; OTHER: from a restart."""


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
        fraction: share of the episodes that start from one, while no episode from a
            true start succeeds.
        num_envs: N.

    Attributes:
        fraction: as given.
        success: [W + 1] running rates of success at the end of the episodes from each
            waypoint, then from true starts.
    """

    def __init__(
        self, waypoints: WaypointStates, fraction: float, num_envs: int
    ) -> None:
        check_share("waypoint_fraction", fraction)
        self.fraction = fraction
        self.success = np.zeros(len(waypoints.names) + 1)
        self._waypoints = waypoints
        self._kind = np.full(num_envs, OTHER)

    @property
    def share(self) -> float:
        """Present share of the episodes that start from a waypoint."""
        return float(self.fraction * (1 - self.success[-1]))

    def begin(
        self, engine: Engine, env_ids: Array, streams: EpisodeStreams, restarted: Array
    ) -> None:
        """Put some of the environments that begin an episode into waypoint states.

        Args:
            engine: of the environments.
            env_ids: [n].
            streams: n streams of the family `FAMILY`.
            restarted: [n] bool, those that do not have a true start.
        """
        unit = streams.uniform(0, 1, 3)
        chosen = unit[:, 0] < self.share
        waypoint = np.searchsorted(self._chances(), unit[:, 1], side="right")
        slot = (unit[:, 2] * self._waypoints.states.shape[1]).astype(np.int64)
        kind = np.where(restarted, OTHER, TRUE_START)
        self._kind[env_ids] = np.where(chosen, waypoint, kind)
        which = waypoint[chosen], slot[chosen]
        states, readings = self._waypoints.states, self._waypoints.readings
        engine.restore(Snapshot(states[which], readings[which]), env_ids[chosen])

    def end(self, done: Array, success: Array) -> None:
        """Count the episodes [N] that are done, and whether they end in success."""
        for env_id in np.flatnonzero(done & (self._kind != OTHER)):
            kind = self._kind[env_id]
            self.success[kind] += RATE * (success[env_id] - self.success[kind])

    def _chances(self) -> Array:
        """[W] cumulative chances of the waypoints; the last one is above 1."""
        weight = np.maximum(1 - self.success[:-1], LEAST)
        chances = np.cumsum(weight / weight.sum())
        chances[-1] = 2.0  # no rounding below 1
        return chances

    def save_state(self) -> dict[str, Any]:
        """Everything that later starts depend on, the states included."""
        return {
            "waypoint_states": self._waypoints.states.copy(),
            "waypoint_readings": self._waypoints.readings.copy(),
            "waypoint_success": self.success.copy(),
            "waypoint_kind": self._kind.copy(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned.

        Raises:
            UserError: it is of other waypoints or environments.
        """
        now = self.save_state()
        saved = {name: state_array(state, name, like) for name, like in now.items()}
        kind, success = saved["waypoint_kind"], saved["waypoint_success"]
        if (kind < OTHER).any() or (kind >= len(self.success) - 1).any():
            raise UserError("waypoint_kind of the saved state names no waypoint")
        if not ((success >= 0) & (success <= 1)).all():
            raise UserError("waypoint_success of the saved state is not from 0 to 1")
        states, readings = saved["waypoint_states"], saved["waypoint_readings"]
        self._waypoints = self._waypoints._replace(states=states, readings=readings)
        self.success[:], self._kind[:] = success, kind
