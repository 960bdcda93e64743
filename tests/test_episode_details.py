"""Details of episodes: milestones, reward terms, motion; the table of episodes."""

import csv

import numpy as np
import pytest
import torch

from manip.envs import make_batch
from manip.envs.adapters.torchrl import TaskEnv
from manip.evaluation.episode_details import DetailTracker
from manip.evaluation.episode_table import episode_rows, episodes_csv
from manip.evaluation.episodes import Episode, run_episodes
from manip.evaluation.motion import ARM_LIMITS, Motion, share_of_limits
from manip.robot_config import ROBOTS
from manip.training.baselines import RandomPolicy

STEPS, ENVS = 8, 2


@pytest.fixture(scope="module")
def env() -> TaskEnv:
    return TaskEnv(make_batch("Lift", ENVS, horizon=STEPS, motion=True), motion=True)


@pytest.fixture(scope="module")
def rows() -> list[dict[str, np.ndarray]]:
    """What the environments gave in each step of the episodes."""
    return []


@pytest.fixture(scope="module")
def episodes(env: TaskEnv, rows: list) -> list[Episode]:
    act = RandomPolicy(None).acting_in(env.batch)

    def recording(parts: dict) -> torch.Tensor:
        action = act(parts)
        rows.append({"action": action.numpy(), **env.batch.motion()})
        return action

    return run_episodes(env, recording, 2 * ENVS, details=DetailTracker(env))


def test_the_terms_of_an_episode_sum_to_its_return(episodes: list[Episode]) -> None:
    for episode in episodes:
        total = sum(episode.details.reward_terms)
        assert total == pytest.approx(episode.total_reward, rel=1e-5)


def test_a_milestone_has_a_first_step_if_it_was_reached(
    episodes: list[Episode],
) -> None:
    for episode in episodes:
        steps = episode.details.milestone_steps
        assert tuple(s is not None for s in steps) == episode.milestones
        assert all(1 <= s <= STEPS for s in steps if s)


def test_episodes_are_numbered_as_the_streams_begin_them(
    episodes: list[Episode],
) -> None:
    assert [e.index for e in episodes] == list(range(2 * ENVS))


def test_peaks_bound_what_the_ends_of_the_steps_show(
    env: TaskEnv, episodes: list[Episode], rows: list
) -> None:
    for env_id in range(ENVS):
        speeds = [np.abs(row["joint_vel"][env_id]) for row in rows[1:STEPS]]
        motion = episodes[env_id].details.motion
        assert (motion.peak_speed >= np.max(speeds, axis=0) - 1e-6).all()
        assert (np.array(motion.peak_torque) > 0).all()
        assert (motion.peak_torque <= env.batch.scene.layout.robots[0].arm.high).all()
        actions = np.array([row["action"][env_id] for row in rows[:STEPS]])
        change = np.abs(np.diff(actions, axis=0)).mean()
        assert motion.action_change == pytest.approx(change, rel=1e-5)


def test_reading_the_motion_does_not_change_it(env: TaskEnv) -> None:
    plain = make_batch("Lift", ENVS, horizon=STEPS)
    env.batch.restart()
    for batch in (plain, env.batch):
        batch.begin(np.arange(ENVS))
        for _ in range(3):
            batch.step(np.full((ENVS, 7), 0.5))
    np.testing.assert_array_equal(plain.engine.states, env.batch.engine.states)


def test_the_table_has_a_row_for_each_episode(
    env: TaskEnv, episodes: list[Episode]
) -> None:
    table = episodes_csv(episode_rows(episodes[::-1], env.batch.task))
    read = list(csv.DictReader(table.splitlines()))
    assert [int(row["index"]) for row in read] == list(range(2 * ENVS))
    assert float(read[1]["reward/reach"]) == episodes[1].details.reward_terms[0]
    assert float(read[1]["peak_speed/7"]) == episodes[1].details.motion.peak_speed[6]


def test_shares_of_limits_are_largest_over_the_joints() -> None:
    motion = Motion((1.0,) * 7, (8.0,) * 7, (75.0,) * 7, 0.0, 0.0, 0.0)
    shares = share_of_limits(motion, "Panda")
    assert shares == pytest.approx(
        {"speed": 1 / 2.175, "torque": 8 / 12, "jerk": 75 / 3750}
    )
    assert set(ARM_LIMITS) == set(ROBOTS)
    assert share_of_limits(motion, "another") == {}
