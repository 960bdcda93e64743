"""Start states of every task: distributed as stock's, and as the docstrings say."""

import numpy as np
import pytest
from scipy.stats import ks_2samp
from scripted import ALL_TASKS

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.sim.robosuite_factory import reseed
from manip.sim.scene import Scene
from manip.sim.stock_reader import stock_reader
from manip.tasks.scenes.reach_scene import GOAL_HIGH, GOAL_LOW
from manip.tasks.stack import Stack

Array = np.ndarray


@pytest.fixture(scope="module", params=ALL_TASKS)
def task(request) -> Task:
    return load_task(request.param)


@pytest.fixture(scope="module")
def scene(task: Task, scene_of) -> Scene:
    return scene_of(task)


def starts(task: Task, scene: Scene, n: int) -> Array:
    """[n, nq + fields]: start states of n episodes."""
    env_ids = np.arange(n)
    start = task.sample_start(scene, EpisodeStreams(0, env_ids, env_ids))
    return np.concatenate([start.qpos, *start.fields.values()], axis=1)


def stock_starts(task: Task, scene: Scene, n: int) -> Array:
    """[n, nq + fields]: start states of stock robosuite."""
    read, rows = stock_reader(scene.stock, task.sensors), []
    reseed(scene.stock, 0)
    for _ in range(n):
        scene.stock.reset()
        now = read()
        fields = [now[name][0] for name in task.sensors.fields]
        rows.append(np.concatenate([now["qpos"][0], *fields]))
    return np.array(rows)


def test_starts_are_distributed_as_stocks(task: Task, scene: Scene) -> None:
    ours, theirs = starts(task, scene, 400), stock_starts(task, scene, 60)
    assert ours.shape[1] == theirs.shape[1]
    for column, (a, b) in enumerate(zip(ours.T, theirs.T, strict=True)):
        if np.ptp(b) < 1e-9:
            np.testing.assert_allclose(a, b[0], atol=1e-9, err_msg=f"column {column}")
        else:
            assert ks_2samp(a, b).pvalue > 1e-3, f"column {column}"


def test_arms_start_in_the_default_pose_with_noise(task: Task, scene: Scene) -> None:
    joints = scene.layout.joint_qpos
    noise = starts(task, scene, 500)[:, joints] - scene.layout.qpos[joints]
    np.testing.assert_allclose(noise.mean(axis=0), 0, atol=0.004)
    np.testing.assert_allclose(noise.std(axis=0), 0.02, rtol=0.1)
    assert np.abs(np.corrcoef(noise.T) - np.eye(len(joints))).max() < 0.2


def test_lift_places_its_cube_as_documented(lift: Task, lift_scene: Scene) -> None:
    cube = starts(lift, lift_scene, 500)[:, lift_scene.free_qpos("cube_main")]
    half = lift_scene.geom_size("cube_g0")[2]
    assert 0.020 <= half <= 0.022
    assert np.abs(cube[:, :2]).max() <= 0.03
    np.testing.assert_allclose(np.ptp(cube[:, :2], axis=0), 0.06, atol=0.002)
    np.testing.assert_allclose(cube[:, 2], 0.8 + 0.01 + half)
    np.testing.assert_allclose(np.linalg.norm(cube[:, 3:], axis=1), 1)
    yaw = 2 * np.arctan2(cube[:, 6], cube[:, 3]) % (2 * np.pi)
    assert np.histogram(yaw, bins=12, range=(0, 2 * np.pi))[0].min() > 20


def test_door_stands_where_documented(door: Task, door_scene: Scene) -> None:
    start = starts(door, door_scene, 500)
    place, turn = start[:, -7:-4] - [-0.12, -0.35, 1.1], start[:, -4:]
    assert np.abs(place[:, :2]).max() <= 0.01
    np.testing.assert_allclose(np.ptp(place[:, :2], axis=0), 0.02, atol=0.001)
    np.testing.assert_allclose(place[:, 2], 0, atol=1e-12)
    yaw = np.rad2deg(2 * np.arctan2(turn[:, 3], turn[:, 0]))
    assert -90 - np.rad2deg(0.25) <= yaw.min() < yaw.max() <= -90
    assert np.ptp(yaw) > 14


def test_stack_places_its_cubes_apart(scene_of) -> None:
    task = Stack()
    scene = scene_of(task)
    start = starts(task, scene, 500)
    a, b = (start[:, scene.free_qpos(f"cube{name}_main")] for name in "AB")
    radii = np.sqrt(2) * (0.02 + 0.025)
    assert radii < np.linalg.norm(a[:, :2] - b[:, :2], axis=1).min() < radii + 0.003
    for cube, half in (a, 0.02), (b, 0.025):
        np.testing.assert_allclose(np.abs(cube[:, :2]).max(axis=0), 0.08, atol=0.002)
        np.testing.assert_allclose(cube[:, 2], 0.8 + 0.01 + half)


def test_reach_draws_its_goals_in_the_box(reach: Task, reach_scene: Scene) -> None:
    goals = starts(reach, reach_scene, 500)[:, -3:]
    assert ((goals >= GOAL_LOW) & (goals <= GOAL_HIGH)).all()
    np.testing.assert_allclose(goals.min(axis=0), GOAL_LOW, atol=0.01)
    np.testing.assert_allclose(goals.max(axis=0), GOAL_HIGH, atol=0.01)
