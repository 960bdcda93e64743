"""Evaluation never starts where training did: streams differ by purpose and seed."""

import numpy as np
import pytest

from manip.envs.episode_streams import CHOICE, EVALUATION, Purpose
from manip.evaluation.runners import EpisodeSettings, make_env
from manip.robot_config import RobotConfig


def starts(backend: str, purpose: int, seed: int = 0) -> set[bytes]:
    """Observations at the start of 4 episodes."""
    settings = EpisodeSettings(
        "Lift", RobotConfig(), episodes=4, seed=seed, purpose=purpose, backend=backend
    )
    if backend == "native":
        rows = make_env(settings, 4).reset()["observation"]
    else:
        rows = stock_starts(settings)
    return {np.asarray(row, np.float32).tobytes() for row in rows}


def stock_starts(settings: EpisodeSettings) -> list[np.ndarray]:
    env = make_env(settings)
    return [env.reset()["observation"][0].numpy() for _ in range(settings.episodes)]


BACKENDS = ["native", pytest.param("stock", marks=pytest.mark.slow)]


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_start_serves_two_purposes_or_two_seeds(backend: str) -> None:
    """Seed 0 of a run and of its evaluation had all of their starts in common."""
    groups = [starts(backend, purpose) for purpose in Purpose]
    groups.append(starts(backend, EVALUATION, seed=1))
    assert [len(group) for group in groups] == [4] * 4
    assert len(set.union(*groups)) == 16


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_same_settings_give_the_same_starts(backend: str) -> None:
    assert starts(backend, CHOICE) == starts(backend, CHOICE)
