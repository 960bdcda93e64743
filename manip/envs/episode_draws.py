"""EpisodeDraws: the values of one perturbation in the present episodes."""

import numpy as np

from manip.envs.perturbation import Perturbation

Array = np.ndarray

CHUNK = 256
"""Control steps whose values are drawn at once, if each step has its own."""

_STREAM, _SHARE_STREAM = 2, 3
"""Numbers of these streams among those of an episode; `look_seed` has 1."""


class EpisodeDraws:
    """Draw the values of N environments; they depend on seed, purpose, environment,
    episode and step only, so there is nothing to save.

    Args:
        perturbation: what is drawn.
        num_envs: N.
        size: values for each environment, k.
    """

    def __init__(self, perturbation: Perturbation, num_envs: int, size: int) -> None:
        self.perturbation = perturbation
        self._length = CHUNK if perturbation.per == "step" else 1
        nominal = perturbation.kind.nominal
        self._values = np.full((num_envs, self._length, size), nominal)
        self._keys: list[tuple[int, ...]] = [()] * num_envs
        self._chunks = np.full(num_envs, -1)

    def begin(
        self, env_ids: Array, seed: int, purpose: int, numbers: Array, episodes: Array
    ) -> None:
        """Give some environments new episodes; see `EpisodeLooks.begin`."""
        for env_id, number, episode in zip(env_ids, numbers, episodes, strict=True):
            self._keys[env_id] = seed, purpose, int(number), int(episode)
        self._chunks[env_ids] = -1

    def at(self, steps: Array) -> Array:
        """[N, k]: the values of control step `steps` [N] of each episode."""
        per_step = self._length > 1
        chunks = steps // CHUNK if per_step else np.zeros_like(steps)
        for env_id in np.flatnonzero(chunks != self._chunks):
            if self._keys[env_id]:
                self._draw(int(env_id), int(chunks[env_id]))
        rows: Array = self._values[np.arange(len(steps)), steps % self._length]
        return rows

    def _draw(self, env_id: int, chunk: int) -> None:
        drawn, shape = self.perturbation, self._values.shape[1:]
        self._chunks[env_id] = chunk
        if self._is_nominal(env_id):
            self._values[env_id] = drawn.kind.nominal
            return
        generator = self._generator(env_id, _STREAM, chunk)
        self._values[env_id] = drawn.draw(generator, shape)

    def _is_nominal(self, env_id: int) -> bool:
        share = self.perturbation.share
        return share < 1 and self._generator(env_id, _SHARE_STREAM).random() >= share

    def _generator(self, env_id: int, *stream: int) -> np.random.Generator:
        """Random numbers of the quantity in the present episode of an environment."""
        seed, purpose, number, episode = self._keys[env_id]
        name = list(self.perturbation.quantity.encode())
        key = purpose, number, episode, *stream, len(name), *name
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
