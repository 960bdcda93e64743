"""Recorded episodes, and the films and stills that are drawn of them."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from pendulum import PENDULUM
from PIL import Image
from sameness import assert_same
from training_runs import finished

from manip.agents.policy import load_policy
from manip.envs import make_batch
from manip.envs.task_registry import load_task
from manip.errors import UserError
from manip.evaluation.episode_recording import RecordedEpisode, record
from manip.evaluation.episodes import Episode
from manip.evaluation.runners import EpisodeSettings
from manip.programs.film import Film, save_film, save_stills
from manip.sim import gl
from manip.training.checkpoint_policy import policy_of_checkpoint
from manip.training.final_evaluation import load_run

draws = pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)

FILM = Film(("front",), 64, 48, 20, 20.0, 1.0, None, False, ("",))


def swing(steps: int, index: int = 0) -> RecordedEpisode:
    """A pendulum that turns by 0.1 rad a step; it succeeds in the last."""
    outcome = Episode(0, steps, 0.0, True, True, False, steps, (), index=index)
    success = np.arange(steps) == steps - 1
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    poses = 0.1 * np.arange(steps)[:, None]
    none = np.zeros((steps, 0))
    return RecordedEpisode(
        outcome, lambda: model, poses, success, none, none, [[]] * steps
    )


def test_one_episode_is_repeated_exactly() -> None:
    """Whichever others run beside it."""
    policy = load_policy("Lift")
    settings = EpisodeSettings(
        load_task("Lift"), policy.card.robot_config, episodes=3, backend="native"
    )
    every = record(policy, settings)
    (alone,) = record(policy, replace(settings, first=2, episodes=1))
    assert [each.episode.index for each in every] == [0, 1, 2]
    assert alone.episode.index == 2
    assert_same(alone.poses, every[2].poses)
    assert len(alone.poses) == alone.episode.steps
    assert not np.array_equal(every[1].poses, every[2].poses)


def test_frames_follow_speed_and_rate() -> None:
    episode = swing(21)  # one second
    for speed, fps, frames in ((1, 20, 21), (0.5, 20, 41), (1, 40, 41), (2, 20, 11)):
        film = replace(FILM, speed=speed, fps=fps)
        assert len(film.places(episode)) == frames
        assert film.places(episode)[-1] == 20
    assert len(replace(FILM, steps=5).places(episode)) == 5


@pytest.mark.slow
@draws
def test_a_film_holds_the_last_frame_of_the_shorter_side(tmp_path: Path) -> None:
    rows, film = [[swing(4)], [swing(6)]], replace(FILM, titles=("a", "b"))
    save_film(tmp_path / "film.gif", rows, film)
    with Image.open(tmp_path / "film.gif") as image:
        assert (image.n_frames, image.size) == (6, (128, 48))


@draws
def test_stills_are_a_row_for_each_episode(tmp_path: Path) -> None:
    film = replace(FILM, cameras=("front", "front"))
    save_stills(tmp_path / "stills.png", [[swing(9), swing(5, 1)]], film, 3)
    with Image.open(tmp_path / "stills.png") as image:
        picture = np.asarray(image)
    assert picture.shape == (2 * 48, 3 * 2 * 64, 3)
    first, last = picture[:48, 64:128], picture[:48, -64:]
    assert np.abs(first.astype(int) - last).max() > 30  # it has moved


def test_a_checkpoint_holds_a_policy() -> None:
    run = finished("sac").folder
    best, task = load_run(run / "checkpoints" / "best.safetensors")
    saved = load_policy(run)
    assert (best.card.env_steps, task.name) == (saved.card.env_steps, "Reach")
    batch = make_batch("Reach", 2)
    batch.begin(np.arange(2))
    parts = batch.observation_spec.split(batch.observe().observation)
    assert bool((best(parts) == saved(parts)).all())
    with pytest.raises(UserError, match="no checkpoint"):
        policy_of_checkpoint(run / "checkpoints" / "first.safetensors")
