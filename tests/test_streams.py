"""Random streams: each episode has its own."""

import numpy as np
import pytest

from manip.envs.episode_streams import (
    CHOICE,
    EVALUATION,
    TRAINING,
    EpisodeStreams,
    Purpose,
    episode_seed,
)

Array = np.ndarray


def draws(
    seed: int, env_ids: list[int], episodes: list[int], purpose: Purpose = TRAINING
) -> Array:
    """Uniform, then Gaussian, then uniform numbers, as a task draws them [n, 9]."""
    streams = EpisodeStreams(seed, np.array(env_ids), np.array(episodes), purpose)
    parts = [
        streams.uniform(0, 1, 4),
        streams.normal(1.0, 3),
        streams.uniform(-1, 1, 2),
    ]
    return np.concatenate(parts, axis=1)


def test_draws_depend_on_seed_environment_and_episode_only() -> None:
    together = draws(5, [0, 1, 2, 3], [7, 7, 0, 9])
    np.testing.assert_array_equal(draws(5, [0, 1, 2, 3], [7, 7, 0, 9]), together)
    np.testing.assert_array_equal(draws(5, [3, 1], [9, 7]), together[[3, 1]])
    np.testing.assert_array_equal(draws(5, [2], [0]), together[[2]])


KEYS = [
    (seed, purpose, env_id, episode)
    for seed in (0, 1, 2, 2**32, 2**63)
    for purpose in Purpose
    for env_id in (0, 1, 2)
    for episode in (0, 1, 2)
]
"""Seeds, purposes, environments and episodes whose sums often coincide."""


def test_no_two_episodes_draw_the_same() -> None:
    rows = np.concatenate([draws(s, [i], [e], purpose) for s, purpose, i, e in KEYS])
    assert np.unique(rows).size == rows.size


def test_no_two_episodes_of_other_libraries_have_the_same_seed() -> None:
    """Neither as a generator's seed, nor as the 32 bits that some libraries take."""
    seeds = [episode_seed(*key) for key in KEYS]
    numbers = [np.random.default_rng(seed).random() for seed in seeds]
    assert len(set(numbers)) == len(KEYS)
    assert len({int(seed.generate_state(1)[0]) for seed in seeds}) == len(KEYS)


def test_draws_of_training_are_keyed_by_the_seed_alone() -> None:
    """So that runs begun before there were purposes can be resumed."""
    generator = np.random.Generator(np.random.Philox(key=5, counter=[0, 0, 7, 2]))
    np.testing.assert_array_equal(draws(5, [2], [7])[0, :4], generator.random(4))
    for purpose in (EVALUATION, CHOICE):
        assert not np.isin(draws(5, [2], [7], purpose), draws(5, [2], [7])).any()


def test_numbers_are_uniform_and_gaussian() -> None:
    n = 2000
    streams = EpisodeStreams(0, np.arange(n), np.zeros(n, dtype=int))
    unit, gauss = streams.uniform(0, 1, 4).ravel(), streams.normal(3.0, 4).ravel()
    assert (unit.min() >= 0, unit.max() < 1) == (True, True)
    assert unit.mean() == pytest.approx(0.5, abs=0.015)
    assert unit.std() == pytest.approx(1 / np.sqrt(12), abs=0.01)
    assert gauss.mean() == pytest.approx(0, abs=0.15)
    assert gauss.std() == pytest.approx(3, abs=0.1)


def test_environments_and_numbers_are_uncorrelated() -> None:
    n = 2000
    streams = EpisodeStreams(0, np.arange(n), np.zeros(n, dtype=int))
    unit = streams.uniform(0, 1, 3)
    neighbours = np.corrcoef(unit[:-1, 0], unit[1:, 0])[0, 1]
    assert abs(neighbours) < 0.1
    assert np.abs(np.corrcoef(unit.T) - np.eye(3)).max() < 0.1


def test_bounds_may_differ_by_number() -> None:
    streams = EpisodeStreams(0, np.arange(500), np.zeros(500, dtype=int))
    low, high = np.array([-1.0, 5.0, 2.0]), np.array([1.0, 6.0, 2.0])
    drawn = streams.uniform(low, high, 3)
    assert ((drawn >= low) & (drawn <= high)).all()
    assert (drawn[:, 2] == 2).all()
    assert np.ptp(drawn[:, :2], axis=0) == pytest.approx([2, 1], abs=0.05)


def test_there_is_a_stream_for_each_environment() -> None:
    assert len(EpisodeStreams(0, np.arange(5), np.arange(5))) == 5
    with pytest.raises(ValueError, match="argument 2 is shorter"):
        EpisodeStreams(0, np.arange(5), np.arange(4))
