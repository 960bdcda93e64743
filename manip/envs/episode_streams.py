"""Random streams of episodes, derived from seed, purpose, environment and episode.

Streams are never derived by adding: seeds 0 and 1, or episodes of training and of an
evaluation with the same seed, share no random numbers.
"""

from enum import IntEnum
from numbers import Integral

import numpy as np

from manip.errors import UserError, shown

Array = np.ndarray


class Purpose(IntEnum):
    """What episodes are for; those of different purposes are different episodes."""

    TRAINING = 0
    EVALUATION = 1
    CHOICE = 2
    """Choosing a checkpoint or a seed: not trained on, and not reported."""


TRAINING, EVALUATION, CHOICE = Purpose


class EpisodeStreams:
    """One counter-based stream (Philox) for each of n episodes.

    The stream of episode e of environment i depends on (seed, purpose, i, e, family)
    only, so the same seed gives the same episodes for any number of environments or
    threads.

    Args:
        seed: below 2^64.
        env_ids: [n] int.
        episodes: [n] int, number of the episode of each environment.
        purpose: what the episodes are for.
        family: streams of different families are independent; 0 is the episodes' own.
    """

    def __init__(
        self,
        seed: int,
        env_ids: Array,
        episodes: Array,
        purpose: Purpose = TRAINING,
        family: int = 0,
    ) -> None:
        key = np.array([seed, purpose], np.uint64)
        self._generators = [
            np.random.Generator(
                np.random.Philox(key=key, counter=[0, family, episode, env_id])
            )
            for env_id, episode in zip(env_ids, episodes, strict=True)
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


def episode_seed(
    seed: int, purpose: int, env_id: int, episode: int
) -> np.random.SeedSequence:
    """The seed of one episode, for libraries that have their own generators.

    With a spawn key, different (seed, purpose, env_id, episode) give different streams.
    """
    return np.random.SeedSequence(seed, spawn_key=(purpose, env_id, episode))


def look_seed(seed: int, purpose: int, env_id: int, episode: int) -> int:
    """The seed (below 2^32) of an episode's look; nothing else depends on it."""
    sequence = np.random.SeedSequence(seed, spawn_key=(purpose, env_id, episode, 1))
    return int(sequence.generate_state(1)[0])


def build_seed(seed: int, purpose: int, env_id: int) -> int:
    """The seed (below 2^32) of what an environment samples when it is built."""
    sequence = np.random.SeedSequence(seed, spawn_key=(purpose, env_id))
    return int(sequence.generate_state(1)[0])


def check_seed(seed: object) -> int:
    """The seed as an int.

    Raises:
        UserError: it is not a whole number from 0 to 2^64 - 1.
    """
    if (
        not isinstance(seed, Integral)
        or isinstance(seed, bool)
        or not 0 <= int(seed) < 2**64
    ):
        raise UserError(
            f"seed must be a whole number from 0 to 2^64 - 1, not {shown(seed)}"
        )
    return int(seed)


def check_purpose(purpose: object) -> Purpose:
    """The purpose of that number.

    Raises:
        UserError: there is none.
    """
    try:
        return Purpose(purpose)  # type: ignore[arg-type]
    except ValueError:
        known = ", ".join(f"{each.value} ({each.name})" for each in Purpose)
        raise UserError(
            f"unknown purpose {shown(purpose)}: choose one of {known}"
        ) from None
