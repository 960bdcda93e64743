"""Push and PickGoal: rewards and start states, in the numbers of their docstrings."""

import numpy as np
import pytest

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Task
from manip.envs.task_registry import load_task
from manip.rewards.compose import weighted_sum
from manip.sim.scene import Scene
from manip.tasks.pick_goal import PickGoal
from manip.tasks.push import Push

Array = np.ndarray

FAR = 1 - np.tanh(1)
"""The reach term at 20 cm in the shaped reward, and at 10 cm in the stock one."""


def reward_of(task: Task, m: Measures, reward: str) -> Array:
    return weighted_sum(task.reward_terms(m, reward), task.weights[reward])


def readings(cube: Array, goal: Array, tool: Array, touch: Array) -> Measures:
    """Readings of cubes, goals and tools at [N, 3] m, the gripper closed.

    touch [N]: whether both finger pads touch the cube.
    """
    return {
        "cube_pos": np.array(cube, float),
        "goal_pos": np.array(goal, float),
        "eef_pos": np.array(tool, float),
        "left_touch": np.array(touch, float),
        "right_touch": np.array(touch, float),
        "gripper_closing": np.ones(len(touch)),
    }


def test_push_pays_as_documented() -> None:
    """Far tool; far goal; within its margin; at it; at it, in the air."""
    gap = np.array([0.2, 0.2, 0.06, 0.0, 0.0])
    height = np.array([0.02, 0.02, 0.02, 0.02, 0.031])
    cube = np.column_stack([0 * gap, 0 * gap, 0.8 + height])
    goal = np.column_stack([gap, 0 * gap, 0 * gap + 0.8])
    tool = cube + np.outer([0.2, 0, 0, 0, 0], [0, 1, 0])
    task = Push()
    m = task.measure(readings(cube, goal, tool, [0, 0, 1, 1, 1]))
    near = 0.3 * (1 - np.tanh(0.3))
    empty = [0.15 * FAR + 0.3 * FAR, 0.15 + 0.3 * FAR]
    shaped = [*empty, 0.35 + near + 0.35 * 0.1, 1, 0.65 + 0.35 * 0.39]
    np.testing.assert_allclose(reward_of(task, m, "shaped"), shaped)
    assert task.success(m).tolist() == [False, False, False, True, False]
    far, middle = 1 - np.tanh(2), 1 - np.tanh(0.6)
    stock = [0.75 * far, 0.25 + 0.5 * far, 0.25 + 0.5 * middle, 1, 0.75]
    np.testing.assert_allclose(reward_of(task, m, "stock"), stock)


def test_pick_goal_pays_as_documented() -> None:
    """Far tool; pressed from above; held on the table; lifted; near; at the goal."""
    height = np.array([0.02, 0.02, 0.02, 0.045, 0.2, 0.2])
    gap = np.array([0.2, 0.2, 0.2, 0.2, 0.06, 0.0])
    cube = np.column_stack([0 * gap, 0 * gap, 0.8 + height])
    goal = cube + np.outer(gap, [0, 1, 0])
    tool = cube + np.outer([0.2, 0.03, 0, 0, 0, 0], [0, 0, 1])
    task = PickGoal()
    m = task.measure(readings(cube, goal, tool, np.array([0, 1, 1, 1, 1, 1])))
    near = 0.5 + 0.25 * (1 - np.tanh(0.3)) + 0.25 * 0.1
    above = 0.15 * (1 - np.tanh(0.15))
    shaped = [0.15 * FAR, above, 0.35, 0.35 + 0.5 * (0.15 + 0.25 * FAR), near, 1]
    np.testing.assert_allclose(reward_of(task, m, "shaped"), shaped, rtol=1e-6)
    assert task.success(m).tolist() == [False] * 5 + [True]
    far, middle = 1 - np.tanh(2), 1 - np.tanh(0.6)
    pressed = 0.25 * (1 - np.tanh(0.3)) + 0.25 + 0.25 * far
    stock = [0.25 * far, pressed, *[0.5 + 0.25 * far] * 2, 0.5 + 0.25 * middle, 1]
    np.testing.assert_allclose(reward_of(task, m, "stock"), stock)


@pytest.mark.parametrize(
    ("name", "low", "high", "apart"),
    [
        ("Push", [-0.12, -0.2, 0.8], [0.12, 0.2, 0.8], 0.1),
        ("PickGoal", [-0.12, -0.2, 0.9], [0.12, 0.2, 1.1], 0.0),
    ],
)
def test_starts_are_where_documented(
    name: str, low: list[float], high: list[float], apart: float, scene_of
) -> None:
    task = load_task(name)
    scene: Scene = scene_of(task)
    env_ids = np.arange(500)
    qpos, fields = task.sample_start(scene, EpisodeStreams(0, env_ids, env_ids))
    goal, cube = fields["goal_place"], qpos[:, scene.free_qpos("cube_main")]
    np.testing.assert_allclose(goal.min(axis=0), low, atol=0.01)
    np.testing.assert_allclose(goal.max(axis=0), high, atol=0.01)
    assert ((goal >= low) & (goal <= high)).all()
    np.testing.assert_allclose(np.abs(cube[:, :2]).max(axis=0), [0.1, 0.15], atol=0.01)
    np.testing.assert_allclose(cube[:, 2], 0.82)
    gaps = np.linalg.norm((goal - cube[:, :3])[:, :2], axis=1)
    assert apart < gaps.min() < apart + 0.02
