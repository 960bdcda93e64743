"""Tasks through Stable-Baselines3 (`make peers`): its contract, and that it learns."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import VectorEnv
from gymnasium.wrappers.vector import TransformAction

import manip.envs.adapters.gymnasium  # noqa: F401 (registers the tasks)
from manip.errors import UserError

Array = np.ndarray

ENDS = ("TimeLimit.truncated", "terminal_observation")

pytest.importorskip("stable_baselines3")

from stable_baselines3 import SAC  # noqa: E402
from stable_baselines3.common.env_checker import check_env  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor  # noqa: E402

from manip.envs.adapters.sb3 import Sb3VecEnv  # noqa: E402


@pytest.fixture
def _shared_scene(reach_scene, monkeypatch) -> None:
    monkeypatch.setattr(
        "manip.envs.backends.native_batch.load_scene", lambda *_: reach_scene
    )


def batch(num_envs: int, steps: int) -> Sb3VecEnv:
    return Sb3VecEnv(
        gymnasium.make_vec("manip/Reach-v0", num_envs=num_envs, max_episode_steps=steps)
    )


@pytest.mark.usefixtures("_shared_scene")
def test_its_checker_passes_the_single_environment() -> None:
    check_env(gymnasium.make("manip/Reach-v0").unwrapped, warn=False)


@pytest.mark.usefixtures("_shared_scene")
def test_an_environment_of_the_batch_is_as_in_its_own_vector_environment() -> None:
    single = DummyVecEnv(
        [lambda: gymnasium.make("manip/Reach-v0", max_episode_steps=3)]
    )
    moves = np.random.default_rng(0).uniform(-1, 1, (7, 1, 7)).astype(np.float32)
    for ours, theirs in zip(play(batch(1, 3), moves), play(single, moves), strict=True):
        for given, expected in zip(ours[:3], theirs[:3], strict=True):
            np.testing.assert_array_equal(given, expected)
            assert (given.dtype, given.shape) == (expected.dtype, expected.shape)
        for name in ENDS if theirs[2] else ():
            np.testing.assert_array_equal(ours[3][0][name], theirs[3][0][name])


def play(envs, moves: Array) -> list[tuple]:
    envs.seed(5)
    envs.reset()
    return [envs.step(move) for move in moves]


@pytest.mark.usefixtures("_shared_scene")
def test_its_monitor_counts_successes() -> None:
    envs = VecMonitor(batch(2, 3), info_keywords=("is_success",))
    envs.reset()
    infos = [envs.step(np.zeros((2, 7)))[3] for _ in range(3)][-1]
    assert [info["episode"]["l"] for info in infos] == [3, 3]
    assert [info["episode"]["is_success"] for info in infos] == [False, False]


def test_environments_that_restart_later_are_refused() -> None:
    late = gymnasium.make_vec("CartPole-v1", num_envs=2, vectorization_mode="sync")
    with pytest.raises(UserError, match="restart in the same step"):
        Sb3VecEnv(late)


# Learning: SAC with the options of our own recipe, small turns, no tuning for SB3.

OPTIONS = {
    "gamma": 0.9,
    "tau": 0.03,
    "learning_rate": 1.5e-3,
    "batch_size": 128,
    "learning_starts": 1_000,
    "train_freq": 1,
    "gradient_steps": 6,
    "policy_kwargs": {"net_arch": [128, 128]},
}


def small_turns(**options: Any) -> VectorEnv:
    scale = np.array([1, 1, 1, 0.1, 0.1, 0.1, 1], np.float32)
    envs = gymnasium.make_vec("manip/Reach-v0", **options)
    return TransformAction(envs, lambda action: scale * action)


def success_held(model: SAC, envs: VectorEnv) -> float:
    """Fraction of episodes whose success is true in their last ten steps."""
    observation, _ = envs.reset(seed=1000)
    streak = np.zeros(envs.num_envs)
    while True:
        action, _ = model.predict(observation, deterministic=True)
        observation, _, _, truncated, info = envs.step(action)
        now = info.get("final_info", info)["success"]
        streak = (streak + 1) * now
        if truncated.all():
            return float(np.mean(streak >= 10))


@pytest.mark.slow
def test_it_learns_reach_through_our_batch() -> None:
    envs = small_turns(num_envs=16, fidelity="fast", stagger=True)
    model = SAC("MlpPolicy", Sb3VecEnv(envs), seed=0, device="cpu", **OPTIONS)
    other_envs = small_turns(num_envs=50)
    assert success_held(model, other_envs) < 0.1
    model.learn(16_000)
    assert success_held(model, other_envs) >= 0.5
