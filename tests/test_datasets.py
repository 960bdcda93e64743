"""Recorded episodes in files of other projects: written, read, replayed, learned."""

import json
import os
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from toy import QUICK_SAC, SPACES

from manip.agents.sac import SAC
from manip.data import hdf5_reading
from manip.data.datasets import WRITERS, read_dataset
from manip.data.recorder import record_round
from manip.data.restored import restored
from manip.data.stored_episode import Recording, StoredEpisode
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.errors import DamagedError, UserError
from manip.programs import record
from manip.training.demonstrations import DatasetRows, check_dataset, rollouts_of
from manip.training.recipes import recipe
from manip.training.run import train

h5py = pytest.importorskip("h5py")
parquet = pytest.importorskip("pyarrow.parquet")
pytest.importorskip("av")
pytest.importorskip("minari")

FORMATS = ("robomimic", "lerobot", "minari")
NOISE = 0.2


@pytest.fixture(scope="module")
def episodes(lift, lift_scene) -> tuple[Recording, list[StoredEpisode]]:
    """Two episodes of Lift's expert, of which the second has noise, with images that
    stand in for a camera's.
    """
    batch = NativeBatch(lift, 2, scene=lift_scene, threads=1, horizon=12)
    stored = list(record_round(TaskEnv(batch, expert=True), NOISE))
    rng = np.random.default_rng(0)
    smooth = rng.integers(0, 256, (13, 2, 2, 3), dtype=np.uint8).repeat(8, 1)
    camera = {"front_image": smooth.repeat(8, 2)}
    part = {"name": "front_image", "shape": [16, 16, 3], "dtype": "uint8"}
    recording = Recording(
        task="Lift",
        robot="Panda",
        controller="OSC_POSE",
        control_freq=20,
        actor="expert",
        observation=[*batch.observation_spec.to_dict(), part | {"role": "camera"}],
        noise=NOISE,
    )
    return recording, [replace(episode, images=camera) for episode in stored]


@pytest.fixture(scope="module", params=FORMATS)
def folder(request, episodes, tmp_path_factory) -> Path:
    recording, stored = episodes
    place = tmp_path_factory.mktemp(request.param)
    relative = Path(os.path.relpath(place))
    WRITERS[request.param](relative, recording, iter(stored))
    return place


def test_what_is_read_was_written(folder: Path, episodes) -> None:
    recording, stored = read_dataset(folder)
    assert recording == episodes[0]
    assert len(stored) == len(episodes[1])
    for given, expected in zip(stored, episodes[1], strict=True):
        steps = given.steps
        assert expected.steps - steps in (0, 1)  # LeRobot's last row is an observation
        for name in ("action", "label", "reward", "success"):
            whole = getattr(expected, name)[:steps]
            np.testing.assert_array_equal(getattr(given, name), whole, name)
        after = expected.observation[: steps + 1]
        np.testing.assert_array_equal(given.observation, after)
        pixels = given.images["front_image"].astype(int)
        error = np.abs(pixels - expected.images["front_image"][: steps + 1])
        assert error.mean() < 12 if steps < expected.steps else error.max() == 0


def test_a_recording_that_fails_leaves_nothing(tmp_path: Path, monkeypatch) -> None:
    def fail(folder: Path, *_: Any) -> None:
        (folder / "half").mkdir(parents=True)
        raise UserError("the disk is full")

    monkeypatch.setitem(record.WRITERS, "robomimic", fail)
    options = record.Record(
        Path("Reach"), tmp_path / "new", "expert", "robomimic", episodes=1
    )
    with pytest.raises(UserError, match="the disk is full"):
        record.record(options)
    assert list(tmp_path.iterdir()) == []


def test_noise_grows_over_the_environments_and_labels_have_none(episodes) -> None:
    first, second = episodes[1]
    assert (first.action == first.label).all()
    assert 0.05 < np.abs(second.action - second.label).mean() < 0.5


def test_states_of_a_file_are_replayed_bit_for_bit(
    episodes, lift, lift_scene, tmp_path
) -> None:
    recording, stored = episodes
    WRITERS["robomimic"](tmp_path, recording, iter(stored))
    _, (_, episode) = read_dataset(tmp_path)
    engine = NativeBatch(lift, 1, scene=lift_scene, threads=1).engine
    nq = lift_scene.nq
    engine.reset(np.arange(1), episode.states[:1, 1 : 1 + nq])
    for action, state in zip(episode.action, episode.states[1:], strict=True):
        engine.step(action[None])
        np.testing.assert_array_equal(engine.states[0, : len(state) - 1], state[1:])
        assert state[0] > 0


def test_observations_are_restored_from_states(episodes, lift, lift_scene) -> None:
    episode = episodes[1][1]
    batch = NativeBatch(lift, 8, scene=lift_scene, threads=1)
    blank = replace(episode, observation=episode.observation[:, :0])
    again = restored(batch, blank)
    spec = batch.observation_spec
    given, expected = spec.split(again.observation), spec.split(episode.observation)
    for name in ("joint_pos", "joint_vel", "gripper_qpos", "gripper_closing"):
        np.testing.assert_array_equal(given[name], expected[name], name)
    # Positions are those of the state, not of the simulation step before it.
    np.testing.assert_allclose(given["eef_pos"], expected["eef_pos"], atol=0.02)
    np.testing.assert_allclose(again.reward, episode.reward, atol=0.01)


def test_states_of_another_model_are_refused(episodes, lift, lift_scene) -> None:
    batch = NativeBatch(lift, 1, scene=lift_scene, threads=1)
    other = replace(episodes[1][0], states=episodes[1][0].states[:, :-1])
    with pytest.raises(UserError, match=r"states have shape .*, expected \[T, 32\]"):
        restored(batch, other)


def test_a_file_of_robomimic_itself_names_its_environment(episodes, tmp_path) -> None:
    recording, stored = episodes
    path = WRITERS["robomimic"](tmp_path, recording, iter(stored))
    with h5py.File(path, "a") as file:
        del file["data"].attrs["manip"]
    foreign, (episode, _) = read_dataset(path)
    assert (foreign.task, foreign.robot, foreign.observation) == ("Lift", "Panda", [])
    assert episode.observation.shape == (13, 0)
    assert episode.states.shape == (13, 32)


def broken(change):
    def damage(path: Path) -> None:
        with h5py.File(path, "a") as file:
            change(file, file["data/demo_0"])

    return damage


def external_link(file, demo) -> None:
    del demo["actions"]
    demo["actions"] = h5py.ExternalLink("/etc/other.hdf5", "/x")


def soft_link(file, demo) -> None:
    del demo["actions"]
    demo["actions"] = h5py.SoftLink("/data/demo_1/actions")


def replaced(name, values):
    def change(file, demo) -> None:
        del demo[name]
        demo[name] = values

    return change


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.write_bytes(b"no"), "damaged or no HDF5 file"),
        (broken(external_link), "is a link, which is not followed"),
        (broken(soft_link), "is a link, which is not followed"),
        (broken(replaced("actions", np.full((12, 7), np.nan))), "not finite"),
        (broken(replaced("actions", np.full((12, 7), 3.0))), "beyond -1 to 1"),
        (broken(replaced("actions", np.zeros((9, 7)))), "has shape"),
        (broken(replaced("actions", b"text")), "is no array of numbers"),
        (broken(replaced("obs/cube_pos", np.zeros((12, 4)))), "damaged"),
        (broken(lambda f, d: f["data"].attrs.pop("env_args")), None),
    ],
)
def test_a_hostile_file_is_one_line(damage, message, episodes, tmp_path) -> None:
    path = WRITERS["robomimic"](tmp_path, episodes[0], iter(episodes[1]))
    damage(path)
    if message is None:  # what this project does not need
        read_dataset(path)
        return
    with pytest.raises(DamagedError, match=message) as error:
        read_dataset(path)
    assert "\n" not in str(error.value)


def test_arrays_larger_than_the_limit_are_not_read(
    episodes, monkeypatch, tmp_path
) -> None:
    path = WRITERS["robomimic"](tmp_path, episodes[0], iter(episodes[1]))
    monkeypatch.setattr(hdf5_reading, "MOST_BYTES", 1000)
    with pytest.raises(DamagedError, match="larger than 1000 bytes"):
        read_dataset(path)


def test_other_folders_are_refused(episodes, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="holds no data set: expected a robomimic"):
        read_dataset(tmp_path)
    WRITERS["lerobot"](tmp_path, episodes[0], iter(episodes[1]))
    info = tmp_path / "meta/info.json"
    values = json.loads(info.read_text())
    info.write_text(json.dumps({k: v for k, v in values.items() if k != "manip"}))
    with pytest.raises(DamagedError, match="another program recorded it"):
        read_dataset(tmp_path)


def test_half_of_each_batch_is_recorded() -> None:
    agent = SAC(replace(QUICK_SAC, batch_size=8, random_steps=0), SPACES)
    agent.add_demonstrations([rollout_of(7.0, 5), rollout_of(7.0, 3)])
    agent.store(rollout_of(-1.0, 6))
    batches = list(agent._sample(3))
    assert [len(rows) for rows in batches] == [8, 8, 8]
    for rows in batches:
        assert sorted(rows[:, 0].tolist()) == [-1.0] * 4 + [7.0] * 4
    assert len(agent.replay) == 6


def rollout_of(value: float, steps: int) -> TensorDict:
    """An episode of the toy problem that stays at a point."""
    place = np.full((steps + 1, 1), value, np.float32)
    action, reward = place[1:] * 0, place[1:, 0] * 0
    success = np.zeros(steps, bool)
    episode = StoredEpisode(place, action, action, reward, success)
    (rollout,) = rollouts_of([episode])
    return rollout


def test_rows_are_given_once_before_any_is_given_again(episodes) -> None:
    rows = DatasetRows(episodes[1], num_envs=4, terms=1, seed=0)
    batches = [rows.collect(None, 3).batch for _ in range(4)]
    given = torch.cat([b["expert_action"].flatten(0, 1) for b in batches])
    labels = np.concatenate([episode.label for episode in episodes[1]])
    for part in (given[:24], given[24:]):
        assert sorted(map(tuple, part.tolist())) == sorted(map(tuple, labels.tolist()))
    again = DatasetRows(episodes[1], num_envs=4, terms=1, seed=0)
    again.load_state({"env": {"position": 24}, "tracker": {}})
    following = again.collect(None, 3).batch
    assert torch.equal(following["observation"], batches[2]["observation"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"algo": "ppo"}, "ppo takes no --dataset: choose one of bc, sac"),
        ({"algo": "bc", "teacher": "Lift"}, "choose one"),
    ],
)
def test_options_that_do_not_fit_a_dataset_are_refused(change, message) -> None:
    config = replace(recipe("Lift", change["algo"]), dataset="x", **change)
    with pytest.raises(UserError, match=message):
        check_dataset(config)


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("data/chunk-000/file-000.parquet", cut_off),
        ("data/chunk-000/file-000.parquet", Path.unlink),
        ("meta/episodes/chunk-000/file-000.parquet", Path.unlink),
        ("meta/info.json", cut_off),
        (
            "videos/observation.images.front/chunk-000/file-000.mp4",
            lambda path: path.write_bytes(b"\0" * 99),
        ),
    ],
)
def test_a_damaged_lerobot_folder_is_one_line(name, damage, episodes, tmp_path) -> None:
    WRITERS["lerobot"](tmp_path, episodes[0], iter(episodes[1]))
    damage(tmp_path / name)
    with pytest.raises(DamagedError, match=f"{tmp_path}") as error:
        read_dataset(tmp_path)
    assert "\n" not in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["bc", "sac"])
def test_a_run_of_a_dataset_continues_bit_for_bit(algo, episodes, tmp_path) -> None:
    recording, stored = episodes
    path = WRITERS["robomimic"](tmp_path / "data", recording, iter(stored))
    common = recipe("Lift", algo)
    config = replace(
        common, dataset=str(path), num_envs=8, eval_episodes=2, steps=6000, threads=2
    )
    whole, stopped, stop = tmp_path / "a", tmp_path / "b", Event()

    def stop_halfway(progress) -> None:
        if progress.env_steps >= 3000:
            stop.set()

    assert train(replace(config, out=whole)).finished
    half = replace(config, out=stopped)
    assert not train(half, callback=stop_halfway, stop=stop).finished
    assert train(replace(half, resume=True)).finished
    first, second = (f / "policy/policy.safetensors" for f in (whole, stopped))
    assert first.read_bytes() == second.read_bytes()
    with pytest.raises(UserError, match="its task is Lift, not Stack"):
        train(replace(config, task="Stack", out=tmp_path / "c"))


@pytest.mark.slow
def test_lerobot_reads_what_was_written(episodes, tmp_path: Path) -> None:
    """LeRobot 0.4.4's own class (pip install lerobot)."""
    lerobot = pytest.importorskip("lerobot.datasets.lerobot_dataset")
    recording, stored = episodes
    WRITERS["lerobot"](tmp_path, recording, iter(stored))
    data = lerobot.LeRobotDataset("manip/lift", root=tmp_path, video_backend="pyav")
    assert (data.num_episodes, data.num_frames, data.fps) == (2, 24, 20)
    item = data[13]
    np.testing.assert_allclose(item["action"], stored[1].action[1])
    state = recording.spec.split(stored[1].observation[1])["joint_pos"]
    np.testing.assert_allclose(item["observation.state"][:7], state)
    upright = stored[1].images["front_image"][1, ::-1].transpose(2, 0, 1) / 255
    assert np.abs(item["observation.images.front"].numpy() - upright).mean() < 0.05
    assert item["task"] == "Lift"
    assert data.meta.stats["action"]["mean"].shape == (7,)


@pytest.mark.slow
def test_robomimic_reads_what_was_written(episodes, tmp_path: Path) -> None:
    """robomimic 0.3.0's own class (pip install robomimic)."""
    dataset = pytest.importorskip("robomimic.utils.dataset")
    obs_utils = pytest.importorskip("robomimic.utils.obs_utils")
    file_utils = pytest.importorskip("robomimic.utils.file_utils")
    recording, stored = episodes
    path = WRITERS["robomimic"](tmp_path, recording, iter(stored))
    obs_utils.initialize_obs_utils_with_obs_specs(
        {"obs": {"low_dim": ["joint_pos", "cube_pos"], "rgb": ["front_image"]}}
    )
    data = dataset.SequenceDataset(
        str(path), ["joint_pos", "cube_pos", "front_image"], ["actions", "rewards"]
    )
    assert (data.n_demos, len(data)) == (2, 24)
    item = data[13]
    np.testing.assert_allclose(item["actions"][0], stored[1].action[1])
    image = item["obs"]["front_image"][0]
    np.testing.assert_allclose(image, stored[1].images["front_image"][1, ::-1])
    meta = file_utils.get_env_metadata_from_dataset(str(path))
    assert meta["env_name"] == "Lift"


@pytest.mark.slow
def test_minari_reads_what_was_written(episodes, tmp_path: Path) -> None:
    minari = pytest.importorskip("minari")
    recording, stored = episodes
    WRITERS["minari"](tmp_path, recording, iter(stored))
    data = minari.MinariDataset(tmp_path / "data")
    assert (data.total_episodes, data.total_steps) == (2, 24)
    episode = next(iter(data.iterate_episodes([1])))
    np.testing.assert_array_equal(episode.actions, stored[1].action)
    assert episode.truncations[-1]
    assert data.observation_space.contains(
        {name: values[0] for name, values in episode.observations.items()}
    )
