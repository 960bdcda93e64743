"""Arguments of the engine that do not fit are refused in one line."""

import numpy as np
import pytest

from manip.errors import UserError
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Scene

NQ, NV = 16, 15


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"qpos": np.zeros((1, 3))}, r"qpos has shape \(1, 3\), expected \(1, 16\)"),
        ({"qpos": np.zeros(NQ)}, r"qpos has shape \(16,\), expected \(1, 16\)"),
        ({"qvel": np.zeros((2, NV))}, r"qvel has shape \(2, 15\), expected \(1, 15\)"),
        ({"qvel": np.full((1, NV), np.nan)}, "not finite"),
        ({"gripper_command": np.zeros((1, 7))}, r"gripper_command has shape \(1, 7\)"),
        ({"fields": {"goal": np.zeros((1, 3))}}, "unknown model field 'goal'"),
        ({"memory": {"start_pos": np.zeros((1, 7))}}, "unknown memory 'start_pos'"),
        ({"env_ids": np.array([2])}, "env_ids must be .* from 0 to 1"),
        ({"env_ids": np.array([-1])}, "env_ids must be .* from 0 to 1"),
        ({"env_ids": np.array([0.0])}, "env_ids must be .* from 0 to 1"),
        ({"env_ids": np.array([True])}, "env_ids must be .* from 0 to 1"),
        ({"env_ids": np.array([[0]])}, "env_ids must be .* from 0 to 1"),
        ({"env_ids": np.array([1, 1])}, "env_ids must be different"),
    ],
)
def test_a_state_of_another_shape_is_refused(
    change: dict, text: str, lift_scene: Scene
) -> None:
    engine = BatchEngine(lift_scene, 2)
    before = engine.save()
    state = {
        "env_ids": np.array([0]),
        "qpos": np.zeros((1, NQ)),
        "qvel": np.zeros((1, NV)),
    }
    with pytest.raises(UserError, match=text):
        engine.set_state(**(state | change))
    np.testing.assert_array_equal(engine.states, before.states)


@pytest.mark.parametrize(
    ("env_ids", "qpos", "fields", "text"),
    [
        ([0], (1, 3), {}, r"qpos has shape \(1, 3\), expected \(1, 9\)"),
        ([0, 1], (1, 9), {}, r"qpos has shape \(1, 9\), expected \(2, 9\)"),
        ([0], (1, 9), {"goal": (1, 3)}, "unknown model field 'goal'"),
        ([0], (1, 9), {"start_pos": (1, 7)}, "unknown model field 'start_pos'"),
        ([0], (1, 9), {"goal_place": (3,)}, r"goal_place has shape \(3,\)"),
        ([5], (1, 9), {}, "env_ids must be"),
    ],
)
def test_a_reset_of_another_shape_is_refused(
    env_ids: list, qpos: tuple, fields: dict, text: str, reach_scene: Scene
) -> None:
    engine = BatchEngine(reach_scene, 2)
    values = {name: np.zeros(shape) for name, shape in fields.items()}
    with pytest.raises(UserError, match=text):
        engine.reset(np.array(env_ids), np.zeros(qpos), values)


def test_memory_is_checked(lift_scene: Scene) -> None:
    with pytest.raises(UserError, match="unknown memory 'height'"):
        BatchEngine(lift_scene, 2).write_memory([0], {"height": np.zeros((1, 1))})


@pytest.mark.parametrize(
    "action",
    [
        [["a"] * 7] * 2,
        [[None] * 7] * 2,
        [[0.0] * 7, [0.0] * 6],
        np.zeros((2, 7), complex),
        "forward",
        None,
    ],
)
def test_actions_that_are_not_numbers_are_refused(action, lift_scene: Scene) -> None:
    with pytest.raises(UserError, match="must be real numbers of shape"):
        BatchEngine(lift_scene, 2).step(action)


@pytest.mark.parametrize("dtype", [bool, np.int8, np.float16, np.float32])
def test_actions_of_any_number_type_are_taken(dtype, lift_scene: Scene) -> None:
    ours, theirs = (BatchEngine(lift_scene, 2) for _ in range(2))
    ours.step(np.ones((2, 7), dtype))
    theirs.step(np.ones((2, 7)))
    np.testing.assert_array_equal(ours.states, theirs.states)
