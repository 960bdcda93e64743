"""Random streams: an episode's draws are its own, whoever else draws."""

import numpy as np
import pytest

from manip.envs.episode_streams import EpisodeStreams

Array = np.ndarray


def draws(seed: int, worlds: list[int], episodes: list[int]) -> Array:
    """Uniform, then Gaussian, then uniform numbers, as a task draws them [n, 9]."""
    streams = EpisodeStreams(seed, np.array(worlds), np.array(episodes))
    parts = [
        streams.uniform(0, 1, 4),
        streams.normal(1.0, 3),
        streams.uniform(-1, 1, 2),
    ]
    return np.concatenate(parts, axis=1)


def test_draws_depend_on_seed_world_and_episode_only() -> None:
    together = draws(5, [0, 1, 2, 3], [7, 7, 0, 9])
    np.testing.assert_array_equal(draws(5, [0, 1, 2, 3], [7, 7, 0, 9]), together)
    np.testing.assert_array_equal(draws(5, [3, 1], [9, 7]), together[[3, 1]])
    np.testing.assert_array_equal(draws(5, [2], [0]), together[[2]])


def test_no_two_episodes_draw_the_same() -> None:
    keys = [
        (seed, world, episode)
        for seed in (0, 1, 2)
        for world in (0, 1, 2)
        for episode in (0, 1, 2)
    ]
    rows = np.concatenate([draws(s, [w], [e]) for s, w, e in keys])
    assert np.unique(rows).size == rows.size


def test_numbers_are_uniform_and_gaussian() -> None:
    n = 2000
    streams = EpisodeStreams(0, np.arange(n), np.zeros(n, dtype=int))
    unit, gauss = streams.uniform(0, 1, 4).ravel(), streams.normal(3.0, 4).ravel()
    assert (unit.min() >= 0, unit.max() < 1) == (True, True)
    assert unit.mean() == pytest.approx(0.5, abs=0.015)
    assert unit.std() == pytest.approx(1 / np.sqrt(12), abs=0.01)
    assert gauss.mean() == pytest.approx(0, abs=0.15)
    assert gauss.std() == pytest.approx(3, abs=0.1)


def test_worlds_and_numbers_are_uncorrelated() -> None:
    n = 2000
    streams = EpisodeStreams(0, np.arange(n), np.zeros(n, dtype=int))
    unit = streams.uniform(0, 1, 3)
    neighbours = np.corrcoef(unit[:-1, 0], unit[1:, 0])[0, 1]
    assert abs(neighbours) < 0.1
    assert np.abs(np.corrcoef(unit.T) - np.eye(3)).max() < 0.1


def test_bounds_may_differ_by_number() -> None:
    streams = EpisodeStreams(0, np.arange(500), np.zeros(500, dtype=int))
    low, high = np.array([-1.0, 5.0, 2.0]), np.array([1.0, 6.0, 2.0])
    found = streams.uniform(low, high, 3)
    assert ((found >= low) & (found <= high)).all()
    assert (found[:, 2] == 2).all()
    assert np.ptp(found[:, :2], axis=0) == pytest.approx([2, 1], abs=0.05)


def test_the_number_of_streams_is_the_number_of_worlds() -> None:
    assert len(EpisodeStreams(0, np.arange(5), np.arange(5))) == 5
    with pytest.raises(ValueError, match="argument 2 is shorter"):
        EpisodeStreams(0, np.arange(5), np.arange(4))
