"""Random streams that belong to an episode of a world, and to nothing else."""

import numpy as np

Array = np.ndarray


class EpisodeStreams:
    """One counter-based stream (Philox) for each of n episodes.

    The stream of episode e of world w depends on (seed, w, e) only, so the same seed
    gives the same episodes whatever the number of worlds or threads.
    """

    def __init__(self, seed: int, worlds: Array, episodes: Array) -> None:
        self._generators = [
            np.random.Generator(
                np.random.Philox(key=seed, counter=[0, 0, episode, world])
            )
            for world, episode in zip(worlds, episodes, strict=True)
        ]

    def __len__(self) -> int:
        return len(self._generators)

    def uniform(self, low: float | Array, high: float | Array, size: int) -> Array:
        """[n, size] numbers, uniform in [low, high)."""
        unit = np.stack([generator.random(size) for generator in self._generators])
        return low + (np.asarray(high) - low) * unit

    def normal(self, scale: float, size: int) -> Array:
        """[n, size] numbers, Gaussian with standard deviation `scale`."""
        draws = [generator.standard_normal(size) for generator in self._generators]
        return scale * np.stack(draws)
