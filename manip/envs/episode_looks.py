"""EpisodeLooks: the look of each environment's present episode."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.envs.episode_streams import look_seed
from manip.envs.option_checks import state_array
from manip.looks import Looks

Array = np.ndarray


class EpisodeLooks:
    """Seeds of the looks of N environments.

    Args:
        looks: what varies.
        num_envs: N.

    Attributes:
        seeds: [N] int64.
    """

    def __init__(self, looks: Looks, num_envs: int) -> None:
        self._looks = looks
        self.seeds = np.zeros(num_envs, np.int64)

    def begin(
        self, env_ids: Array, seed: int, purpose: int, numbers: Array, episodes: Array
    ) -> None:
        """Give some environments the looks of new episodes.

        Args:
            env_ids: [n] int.
            seed, purpose: of the episodes.
            numbers: [n] int, of the environments in the random streams.
            episodes: [n] int.
        """
        unseen = self._looks.unseen
        for env_id, number, episode in zip(env_ids, numbers, episodes, strict=True):
            if unseen:
                self.seeds[env_id] = unseen[(number + episode) % len(unseen)]
            else:
                key = seed, purpose, int(number), int(episode)
                self.seeds[env_id] = look_seed(*key)

    def save_state(self) -> dict[str, Any]:
        """The seeds, if anything varies."""
        return {"looks": self.seeds.copy()} if self._looks.groups else {}

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Restore what `save_state` returned.

        Raises:
            UserError: it is of other environments, or of some that look the same.
        """
        if self._looks.groups:
            self.seeds[:] = state_array(state, "looks", self.seeds)
