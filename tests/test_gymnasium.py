"""Tasks through Gymnasium: its own checks, batches, ends of episodes, seeds."""

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from manip.envs.adapters.gymnasium import TaskEnv, TaskVectorEnv
from manip.envs.backends import native_batch as native
from manip.envs.backends import stock_batch as stock
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task_registry import load_task, task_names
from manip.errors import UserError
from manip.sim import gl
from manip.sim.stock_driver import StockDriver

Array = np.ndarray

SAME_STEP = {"autoreset_mode": AutoresetMode.SAME_STEP}


@pytest.fixture(autouse=True)
def _shared_scenes(scene_of, monkeypatch) -> None:
    """Environments share the scenes of the session instead of building their own."""

    def load_scene(name, sensors, *_, **__):
        (task,) = (t for t in map(load_task, task_names()) if t.robosuite_name == name)
        return scene_of(task)

    monkeypatch.setattr(native, "load_scene", load_scene)
    monkeypatch.setattr(
        stock,
        "open_stock",
        lambda name, *_, **__: StockDriver(load_scene(name, None).stock),
    )


Make = Callable[..., gymnasium.vector.VectorEnv]


@pytest.fixture
def reaches() -> Make:
    """Build N environments of Reach that end after 4 steps."""
    return partial(gymnasium.make_vec, "manip/Reach-v0", max_episode_steps=4)


def actions(steps: int, num_envs: int, seed: int = 0) -> Array:
    """[steps, N, 7] that do not depend on N in the environments they share."""
    rngs = [np.random.default_rng([seed, env_id]) for env_id in range(num_envs)]
    drawn = [rng.uniform(-1, 1, (steps, 7)).astype(np.float32) for rng in rngs]
    return np.stack(drawn, axis=1)


def play(envs, moves: Array, seed: int = 5) -> list[tuple]:
    """Results of a reset and of the moves, in Gymnasium's order."""
    return [envs.reset(seed=seed), *(envs.step(move) for move in moves)]


# Registration and Gymnasium's own checks


@pytest.mark.parametrize("name", task_names())
@pytest.mark.parametrize("env", ["native", "stock"])
def test_gymnasiums_checker_passes(name: str, env: str) -> None:
    made = gymnasium.make(f"manip/{name}-v0", backend=env)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(made.unwrapped, skip_render_check=True)
    assert all("infinity" in str(each.message) for each in caught)


@pytest.mark.parametrize("name", task_names())
def test_ids_make_the_batch_and_the_single_environment(name: str) -> None:
    many = gymnasium.make_vec(f"manip/{name}-v0", num_envs=3)
    one = gymnasium.make(f"manip/{name}-v0")
    assert isinstance(many, TaskVectorEnv)
    assert isinstance(one.unwrapped, TaskEnv)
    assert one.spec.max_episode_steps == many.batch.horizon == load_task(name).horizon
    assert many.single_observation_space == one.observation_space
    assert many.single_action_space == one.action_space
    assert many.observation_space.shape == (3, *one.observation_space.shape)
    assert many.action_space.shape == (3, *one.action_space.shape)
    assert json.loads(one.spec.to_json())["kwargs"] == {"task": name}


def test_options_reach_the_batch() -> None:
    envs = gymnasium.make_vec("manip/Reach-v0", num_envs=2, reward="stock", threads=1)
    assert envs.batch.reward_set == "stock"
    assert envs.batch.engine.threads == 1


def test_mistakes_are_errors() -> None:
    with pytest.raises(UserError, match="unknown task 'Raech': did you mean 'Reach'"):
        TaskVectorEnv("Raech", 2)
    with pytest.raises(UserError, match="unknown backend 'stok': did you mean 'stock'"):
        gymnasium.make("manip/Reach-v0", backend="stok")
    with pytest.raises(UserError, match="unknown reward 'sparse'"):
        gymnasium.make("manip/Reach-v0", reward="sparse")


@pytest.mark.parametrize("build", [TaskEnv, TaskVectorEnv])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"horizon": 9}, "option 'horizon' is not Gymnasium's: use max_episode_steps"),
        ({"seed": 9}, "option 'seed' is not Gymnasium's: use reset"),
        ({"thread": 1}, "unknown option 'thread': did you mean 'threads'"),
        ({"render_mode": "human"}, "unknown render mode|does not render"),
    ],
)
def test_options_of_another_name_are_refused(build, options: dict, message) -> None:
    with pytest.raises(UserError, match=message):
        build("Reach", **options)


class NeedsGradient:
    """Refuses to become an array, as torch's tensors that need gradients do."""

    def __array__(self, *_: object, **__: object) -> Array:
        raise RuntimeError("Can't call numpy() on Tensor that requires grad")


@pytest.mark.parametrize("action", [np.zeros(6), np.zeros((1, 7)), NeedsGradient()])
def test_an_action_of_another_shape_is_refused(action) -> None:
    env = TaskEnv("Reach")
    env.reset(seed=0)
    with pytest.raises(UserError, match=r"the action .*\(7,\)"):
        env.step(action)


def test_a_reset_of_some_environments_is_refused(reaches: Make) -> None:
    envs = reaches(num_envs=2)
    with pytest.raises(UserError, match="reset_mask is not supported"):
        envs.reset(options={"reset_mask": np.array([True, False])})


def test_stepping_environments_does_not_load_torch() -> None:
    code = (
        "import sys, manip.envs.adapters.gymnasium; assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# A batch is its environments


def test_results_are_in_their_spaces(reaches: Make) -> None:
    envs = reaches(num_envs=3)
    (first, _), *steps = play(envs, actions(6, 3))
    for observation in first, *(step[0] for step in steps):
        assert observation in envs.observation_space
    for _, reward, terminated, truncated, _ in steps:
        assert (reward.shape, reward.dtype) == ((3,), np.float64)
        for flags in terminated, truncated:
            assert (flags.shape, flags.dtype) == ((3,), bool)


def test_infos_are_batched_as_gymnasium_batches_them(reaches: Make) -> None:
    theirs = reaches(num_envs=3, vectorization_mode="sync", vector_kwargs=SAME_STEP)
    for ours, expected in zip(
        play(reaches(num_envs=3), actions(9, 3)),
        play(theirs, actions(9, 3)),
        strict=True,
    ):
        assert_batched_alike(ours[-1], expected[-1])


def assert_batched_alike(ours: dict, theirs: dict) -> None:
    """The same names, kinds and shapes, and the same masks of entries."""
    assert ours.keys() == theirs.keys()
    for name, value in theirs.items():
        assert type(ours[name]) is type(value), name
        if isinstance(value, dict):
            assert_batched_alike(ours[name], value)
        else:
            assert (ours[name].shape, ours[name].dtype) == (value.shape, value.dtype)
            assert not name.startswith("_") or (ours[name] == value).all(), name


def test_environment_0_of_a_batch_is_the_single_environment(reaches: Make) -> None:
    theirs = reaches(num_envs=1, vectorization_mode="sync", vector_kwargs=SAME_STEP)
    moves = actions(9, 2)
    ours = play(reaches(num_envs=2), moves)
    for many, one in zip(ours, play(theirs, moves[:, :1]), strict=True):
        assert data_equivalence(tuple(row_0(part) for part in many), one, exact=True)


def row_0(part):
    if isinstance(part, dict):
        return {name: row_0(value) for name, value in part.items()}
    return part[:1]


def test_a_batch_repeats_the_native_batch_under_it(reaches: Make) -> None:
    batch = NativeBatch(load_task("Reach"), 2, horizon=4, seed=5)
    (first, _), *steps = play(reaches(num_envs=2), actions(3, 2))
    batch.begin(np.arange(2))
    np.testing.assert_array_equal(first, batch.observe().observation)
    for move, (observation, reward, *_, info) in zip(actions(3, 2), steps, strict=True):
        time_step = batch.step(move)
        np.testing.assert_array_equal(observation, time_step.observation)
        np.testing.assert_array_equal(reward, time_step.reward)
        np.testing.assert_array_equal(info["success"], time_step.success)
        np.testing.assert_array_equal(
            info["milestones"]["near"], time_step.milestones["near"]
        )


# Ends of episodes


def test_a_time_limit_truncates_and_restarts_in_the_same_step(reaches: Make) -> None:
    (first, _), *steps = play(reaches(num_envs=2), actions(9, 2))
    endless = play(reaches(num_envs=2, max_episode_steps=99), actions(4, 2))
    truncated = [bool(step[3].all()) for step in steps]
    assert truncated == [step % 4 == 3 for step in range(9)]
    assert not any(step[2].any() for step in steps)
    for step, ends in zip(steps, truncated, strict=True):
        assert ("final_obs" in step[-1]) == ("final_info" in step[-1]) == ends
    last = steps[3][-1]
    np.testing.assert_array_equal(np.stack(last["final_obs"]), endless[-1][0])
    final, expected = last["final_info"], endless[-1][-1]
    assert data_equivalence(final, expected, exact=True)
    assert steps[3][-1]["_final_obs"].all()
    restarted = steps[3][0]
    assert np.abs(restarted - endless[-1][0]).max(axis=1).min() > 0.1
    assert np.abs(restarted - first).max(axis=1).min() > 0.01


def test_only_environments_that_end_have_a_final_info(reaches: Make) -> None:
    envs = reaches(num_envs=3, max_episode_steps=99)
    moves = actions(2, 3)
    moves[1, 1, 2] = np.nan
    *_, (observation, _, terminated, truncated, info) = play(envs, moves)
    assert not terminated.any()
    assert truncated.tolist() == [False, True, False]
    assert [final is not None for final in info["final_obs"]] == truncated.tolist()
    for mask in info["_final_obs"], info["_final_info"], info["final_info"]["_success"]:
        assert mask.tolist() == truncated.tolist()
    assert info["final_info"]["reward_terms"]["near"].astype(bool).tolist() == [0, 1, 0]
    assert np.isfinite(observation).all()


def test_nothing_returned_changes_later(reaches: Make) -> None:
    envs = reaches(num_envs=2)
    results = play(envs, actions(5, 2))
    before = [json.dumps(part, default=lambda a: a.tolist()) for part in results]
    play(envs, actions(5, 2, seed=1), seed=6)
    after = [json.dumps(part, default=lambda a: a.tolist()) for part in results]
    assert before == after


def test_gymnasiums_statistics_count_our_episodes(reaches: Make) -> None:
    envs = RecordEpisodeStatistics(reaches(num_envs=2))
    *_, fourth = play(envs, actions(4, 2))
    assert fourth[-1]["episode"]["l"].tolist() == [4, 4]
    assert (fourth[-1]["episode"]["r"] > 0).all()


# Seeds


def test_a_seed_restarts_its_episodes(reaches: Make) -> None:
    envs, moves = reaches(num_envs=2), actions(9, 2)
    first = play(envs, moves, seed=7)
    other = play(envs, moves, seed=8)
    again = play(envs, moves, seed=7)
    assert data_equivalence(first, again, exact=True)
    assert not np.isclose(first[0][0], other[0][0]).all(axis=1).any()


def test_without_a_seed_resets_go_on_and_differ_between_environments(
    reaches: Make,
) -> None:
    envs = reaches(num_envs=2)
    starts = [envs.reset(seed=7)[0], envs.reset()[0], reaches(num_envs=2).reset()[0]]
    starts += [reaches(num_envs=2).reset()[0]]
    rows = np.concatenate(starts)
    gaps = np.linalg.norm(rows[:, None] - rows, axis=2) + 9 * np.eye(len(rows))
    assert gaps.min() > 0.01


def starts(envs: gymnasium.vector.VectorEnv) -> Array:
    """Observations [16, D] of a reset with seed 0, and of three more, of 4 each."""
    return np.concatenate([envs.reset(seed=s)[0] for s in (0, None, None, None)])


@pytest.mark.parametrize("mode", ["batch", "native", "stock"])
def test_streams_of_environments_and_episodes_do_not_overlap(mode: str) -> None:
    """Gymnasium seeds environment i with seed + i; none may add the episode to it."""
    options = {} if mode == "batch" else {"vectorization_mode": "sync", "backend": mode}
    envs = gymnasium.make_vec("manip/Reach-v0", num_envs=4, **options)
    rows = starts(envs)
    gaps = np.linalg.norm(rows[:, None] - rows, axis=2) + 9 * np.eye(16)
    assert gaps.min() > 0.01
    np.testing.assert_array_equal(starts(envs), rows)


def test_an_arm_is_named_by_a_string() -> None:
    env = gymnasium.make("manip/Reach-v0", robot="Panda")
    assert env.unwrapped.metadata["render_fps"] == 20
    with pytest.raises(UserError, match="unknown robot 'Pand': did you mean 'Panda'"):
        gymnasium.make("manip/Reach-v0", robot="Pand")


@pytest.mark.parametrize("steps", [-1, 0, 2.5, 10**12])
def test_a_time_limit_out_of_range_is_refused(steps: float) -> None:
    with pytest.raises(UserError, match="horizon must be at"):
        gymnasium.make_vec("manip/Reach-v0", num_envs=2, max_episode_steps=steps)


def test_a_users_own_tasks_and_assets_do_not_hide_ours(tmp_path: Path) -> None:
    """Beside tasks.py or a package tasks/, all tasks are there, and so are his own."""
    (tmp_path / "tasks").mkdir()
    (tmp_path / "tasks/__init__.py").write_text("")
    (tmp_path / "tasks/press.py").write_text(OWN)
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets/__init__.py").write_text("")
    (tmp_path / "manip_test.py").write_text(USE)
    (tmp_path / "door.py").write_text("1 / 0")
    command = [sys.executable, "manip_test.py"]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    subprocess.run(command, cwd=tmp_path, env=environment, check=True)


OWN = """
from manip.tasks.lift import Lift
class Press(Lift): pass
"""

USE = """
import gymnasium
import manip.envs.adapters.gymnasium
from manip.agents.policy import shipped_policies
from manip.envs.task_registry import load_task, task_names
assert all(f"manip/{name}-v0" in gymnasium.registry for name in task_names())
assert {"Door", "Lift"} <= {*task_names()} and "Lift" in shipped_policies()
assert type(load_task("tasks.press:Press")).__module__ == "tasks.press"
"""


# Images


@pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)
@pytest.mark.parametrize(
    "where", ["native", pytest.param("stock", marks=pytest.mark.slow)]
)
def test_the_present_state_is_drawn(where: str) -> None:
    env = gymnasium.make("manip/Reach-v0", backend=where, render_mode="rgb_array")
    env.reset(seed=1)
    still, same = env.render(), env.render()
    for _ in range(3):
        env.step(np.ones(7, np.float32))
    moved = env.render()
    env.reset()
    other = env.render()
    env.close()
    env.close()
    assert (still.shape, still.dtype) == ((480, 640, 3), np.uint8)
    np.testing.assert_array_equal(still, same)
    for picture in moved, other:
        assert np.abs(picture.astype(int) - still).max() > 30


@pytest.mark.slow
@pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)
def test_an_environment_that_rendered_and_was_not_closed_exits_in_silence() -> None:
    code = (
        "import gymnasium, manip.envs.adapters.gymnasium as _\n"
        "env = gymnasium.make('manip/Reach-v0', render_mode='rgb_array')\n"
        "env.reset(seed=1); env.render()\n"
    )
    command = [sys.executable, "-W", "error", "-c", code]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "Traceback" not in result.stderr
    assert "EGL" not in result.stderr


def test_without_a_render_mode_nothing_is_drawn() -> None:
    env = TaskEnv("Reach")
    env.reset()
    assert env.render() is None


def test_what_a_vector_environment_cannot_do_is_explained() -> None:
    with pytest.raises(UserError, match="choose vectorization_mode='sync'"):
        gymnasium.make_vec("manip/Reach-v0", num_envs=2, render_mode="rgb_array")
    with pytest.raises(UserError, match="use max_episode_steps"):
        gymnasium.make_vec("manip/Reach-v0", num_envs=2, horizon=5)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "stock"])
def test_a_program_ends_cleanly_with_a_renderer_open(backend: str) -> None:
    code = f"""
import gymnasium, manip.envs.adapters.gymnasium
env = gymnasium.make("manip/Lift-v0", backend={backend!r}, render_mode="rgb_array")
env.reset(seed=0)
print(env.render().shape)
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (0, "(480, 640, 3)\n"), done.stderr
    assert "Traceback" not in done.stderr
