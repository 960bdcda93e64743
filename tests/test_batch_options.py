"""Options and arguments of task batches are checked."""

import numpy as np
import pytest
from rollouts import actions, native
from scripted import TASKS
from tiny import Tiny

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.make_batch import make_batch
from manip.envs.task import Task
from manip.envs.task_batch import TaskBatch
from manip.envs.task_registry import load_task
from manip.errors import UserError
from manip.robot_config import RobotConfig
from manip.sim.scene import Scene

Array = np.ndarray


@pytest.fixture(scope="module", params=TASKS)
def task(request) -> Task:
    return load_task(request.param)


@pytest.fixture(scope="module")
def scene(task: Task, scene_of) -> Scene:
    return scene_of(task)


@pytest.fixture(scope="module")
def tiny_scene(scene_of) -> Scene:
    return scene_of(Tiny())


# Options and arguments are checked in Python, too

WRONG_OPTIONS = [
    ({"num_envs": 0}, "num_envs must be at least 1, not 0"),
    ({"num_envs": 2.5}, "num_envs must be at least 1, not 2.5"),
    ({"num_envs": 10**11}, "num_envs must be at most"),
    ({"num_envs": None}, "num_envs must be at least 1, not None"),
    ({"horizon": 0}, "horizon must be at least 1, not 0"),
    ({"horizon": -5}, "horizon must be at least 1, not -5"),
    ({"horizon": 2.5}, "horizon must be at least 1, not 2.5"),
    ({"horizon": 10**11}, "horizon must be at most"),
    ({"threads": 0}, "threads must be at least 1, not 0"),
    ({"threads": 1.5}, "threads must be at least 1, not 1.5"),
    ({"seed": -1}, "seed must be a whole number from 0 to"),
    ({"seed": 0.5}, "seed must be a whole number from 0 to"),
    ({"seed": "1"}, "seed must be a whole number from 0 to"),
    ({"seed": None}, "seed must be a whole number from 0 to"),
    ({"seed": 2**64}, "seed must be a whole number from 0 to"),
    ({"purpose": 7}, "unknown purpose 7: choose one of 0 .TRAINING., 1"),
    ({"restart_fraction": -0.1}, "restart_fraction must be a number from 0 to 1"),
    ({"restart_fraction": 1.5}, "restart_fraction must be a number from 0 to 1"),
    ({"restart_fraction": np.nan}, "restart_fraction must be a number from 0 to 1"),
    ({"restart_fraction": "all"}, "restart_fraction must be a number from 0 to 1"),
    ({"fidelity": "fasst"}, "unknown fidelity 'fasst': did you mean 'fast'"),
    ({"reward": "sparse"}, "unknown reward 'sparse': known rewards: shaped"),
    ({"reward_weights": {"clsing": 1}}, "unknown reward term 'clsing': did you mean"),
    ({"reward_weights": {"closing": np.nan}}, "weight of reward term 'closing' must"),
    ({"reward_weights": {"closing": np.inf}}, "weight of reward term 'closing' must"),
    ({"reward_weights": {"closing": 1e9}}, "weight of reward term 'closing' must be"),
    ({"reward_weights": {"closing": "1"}}, "weight of reward term 'closing' must be"),
    ({"reward_weights": 3}, "reward_weights must be term=weight pairs, not 3"),
    ({"robot": "Pand"}, "unknown robot 'Pand': did you mean 'Panda'"),
    ({"robot": 5}, "robot must be a RobotConfig or an arm's name, not 5"),
    ({"robot": RobotConfig(control_freq=30)}, "control_freq 30 is not supported"),
    ({"robot": RobotConfig(controller="OSC")}, "unknown controller 'OSC'"),
    ({"num_envs": True}, "num_envs must be at least 1, not True"),
    ({"horizon": True}, "horizon must be at least 1, not True"),
    ({"threads": True}, "threads must be at least 1, not True"),
    ({"first_env": True}, "first_env must be at least 0, not True"),
    ({"restart_fraction": True}, "restart_fraction must be a number from 0 to 1"),
    ({"stagger": "no"}, "stagger must be True or False, not 'no'"),
    ({"scene": 3}, "scene must be a Scene, not 3"),
    ({"horizn": 3}, "unknown option 'horizn': did you mean 'horizon'"),
    (
        {"hard_reset": True},
        "unknown option 'hard_reset': .*known options: cameras, fid",
    ),
    ({"backend": "stock", "num_envs": 1, "threads": 1}, "unknown option 'threads'"),
    ({"backend": "stock", "num_envs": 1, "hard_reset": "no"}, "hard_reset must be Tru"),
    ({"task": 3}, "task must be a Task or its name, not 3"),
    ({"task": Tiny}, "task must be a Task or its name, not <class"),
    ({"task": "dm_control/reach_site_features", "stagger": 2}, "stagger must be True"),
    ({"backend": "stok"}, "unknown backend 'stok': did you mean 'stock'"),
]


@pytest.mark.parametrize(("options", "message"), WRONG_OPTIONS)
def test_options_out_of_range_are_refused(
    options: dict, message: str, tiny_scene: Scene
) -> None:
    """Where the robot is given, the scene must be built for it."""
    other = {"robot", "task"} & set(options) or options.get("backend") == "stock"
    shared = {} if other else {"scene": tiny_scene}
    with pytest.raises(UserError, match=message):
        make_batch(**({"task": Tiny(), "num_envs": 2} | shared | options))


@pytest.mark.parametrize("seed", [-1, 1.5, 2**64, "1"])
def test_a_seed_out_of_range_is_refused_at_a_restart(seed, tiny_scene: Scene) -> None:
    batch = native(Tiny(), tiny_scene).batch
    with pytest.raises(UserError, match="seed must be a whole number"):
        batch.restart(seed)


def test_given_weights_replace_those_of_the_set(lift: Task, lift_scene: Scene) -> None:
    batch = native(lift, lift_scene, reward_weights={"lift": 0.0, "reach": 2.0}).batch
    assert batch.reward_weights == {
        "reach": 2.0,
        "grasp": 0.25,
        "lift": 0.0,
        "upright": 0.0,
    }
    batch.begin(np.arange(4))
    time_step = batch.step(actions(1, 4)[0].numpy())
    terms = time_step.reward_terms
    expected = 2.0 * terms["reach"] + 0.25 * terms["grasp"] + 0.0 * terms["lift"]
    np.testing.assert_allclose(time_step.reward, expected, rtol=1e-12)


def batches(scene: Scene, task: Task) -> dict[str, TaskBatch]:
    return {
        "native": NativeBatch(task, 1, scene=scene),
        "stock": StockBatch(task, stock=scene.stock),
    }


@pytest.mark.parametrize("backend", ["native", "stock"])
def test_a_step_before_the_first_reset_is_refused(
    backend: str, lift: Task, lift_scene: Scene
) -> None:
    batch = batches(lift_scene, lift)[backend]
    for _ in range(2):
        with pytest.raises(UserError, match=r"step\(\) was called before reset\(\)"):
            batch.step(np.zeros((1, 7)))
        batch.begin(np.zeros(1, int))
        batch.step(np.zeros((1, 7)))
        batch.restart()


@pytest.mark.parametrize("backend", ["native", "stock"])
@pytest.mark.parametrize(
    "action",
    [
        np.zeros((1, 6)), np.zeros(7), np.zeros((2, 7)), np.zeros((1, 7, 1)), 0.0,
        [["up"] * 7], None, np.zeros((1, 7), complex), [[0.0], [0.0, 1.0]],
    ],
)  # fmt: skip
def test_an_action_of_another_shape_or_kind_is_refused(
    action, backend: str, lift: Task, lift_scene: Scene
) -> None:
    batch = batches(lift_scene, lift)[backend]
    batch.begin(np.zeros(1, int))
    before = batch.elapsed.copy()
    with pytest.raises(UserError, match="the action"):
        batch.step(action)
    np.testing.assert_array_equal(batch.elapsed, before)


@pytest.mark.parametrize("backend", ["native", "stock"])
@pytest.mark.parametrize(
    "env_ids",
    [
        [-1], [1], [0, 0], [True], [0.0], [[0]], 0, None, "0", slice(None), [2**40],
        [[0], [0, 0]],
    ],
)  # fmt: skip
def test_environments_that_do_not_exist_do_not_begin(
    env_ids, backend: str, lift: Task, lift_scene: Scene
) -> None:
    batch = batches(lift_scene, lift)[backend]
    with pytest.raises(UserError, match="env_ids must be different whole numbers"):
        batch.begin(env_ids)
    assert batch.episode[0] == -1


@pytest.mark.parametrize("env_ids", [[0], (0,), np.array([0], np.uint8)])
def test_environments_begin_by_any_sequence_of_indices(
    env_ids, lift: Task, lift_scene: Scene
) -> None:
    batch = batches(lift_scene, lift)["native"]
    batch.begin(env_ids)
    assert batch.episode[0] == 0


@pytest.mark.parametrize("state", [{}, None, [], {"states": np.zeros((1, 39))}])
def test_a_saved_state_without_its_parts_is_refused(
    state, lift: Task, lift_scene: Scene
) -> None:
    with pytest.raises(UserError, match="saved state"):
        batches(lift_scene, lift)["native"].load_state(state)
