"""PickPlace: rewards and start states, in the numbers of its docstrings."""

import mujoco
import numpy as np
import pytest

from manip.envs.episode_streams import EpisodeStreams
from manip.rewards.compose import weighted_sum
from manip.sim.batch_engine import BatchEngine
from manip.tasks.pick_place import (
    OneObject,
    PickPlaceBread,
    PickPlaceCan,
    PickPlaceCereal,
    PickPlaceMilk,
)
from manip.tasks.pick_place_items import ITEMS

TASKS = (PickPlaceBread, PickPlaceCan, PickPlaceCereal, PickPlaceMilk)


def stage_measures(task: OneObject) -> dict[str, np.ndarray]:
    """Measures of nine stages: far, near, grasped, 8 cm up, 20 cm up, over its place,
    half opened there, just released there, inside.
    """
    item = ITEMS[task.item]
    place = np.array([*item.place, 0.0])
    offsets = np.zeros((9, 3))
    offsets[:5, 1] = -0.5
    offsets[:, 2] = 0.8 + item.stand + np.array([0, 0, 0, 8, 20, 15, 15, 15, 0]) / 100
    offsets[8, 2] = 0.87
    position = place + offsets
    above = np.array([item.grip + 0.2, *[item.grip] * 7, 0.1])
    touch = np.array([0.0, 0, 1, 1, 1, 1, 1, 0, 0])
    read = {
        "object_pos": position,
        "object_quat": np.tile([1.0, 0, 0, 0], (9, 1)),
        "other_Cereal_pos": np.tile([10.0, 10, 0.0], (9, 1)),
        "eef_pos": position + np.outer(above, [0, 0, 1]),
        "left_touch": touch,
        "right_touch": np.maximum(touch, [0, 0, 0, 0, 0, 0, 0, 1, 0]),
        "gripper_closing": np.array([-1.0, -1, 1, 1, 1, 1, 0, 0, -1]),
    }
    return task.measure(read)


@pytest.mark.parametrize("cls", TASKS)
def test_it_pays_as_documented_and_more_each_stage(cls) -> None:
    task, tanh = cls(), np.tanh
    m, item = stage_measures(task), ITEMS[cls.item]
    shaped = weighted_sum(task.reward_terms(m, "shaped"), task.weights["shaped"])
    carried = 0.25 * (1 - 0.5 / 0.75)
    grasped = [0.25, 0.25 + 0.4 * (0.15 + carried), 0.4 + carried, 0.7, 0.75]
    released = 0.8 + 0.2 * 0.5 * np.clip(item.grip / (np.arctanh(0.4) / 10), 0, 1)
    expected = [0.1 * (1 - tanh(1)), 0.1, *grasped, released, 1]
    np.testing.assert_allclose(shaped, expected)
    assert (np.diff(shaped) > 0).all()
    assert task.success(m).tolist() == [False] * 8 + [True]


def test_a_box_that_leans_above_its_place_is_not_paid_as_released() -> None:
    task, angle = PickPlaceCereal(), np.radians([0, 10, 30, 45])
    read = {name: rows[[7] * 4] for name, rows in stage_measures(task).items()}
    half = angle[:, None] / 2
    read["object_quat"] = np.hstack([np.cos(half), np.sin(half), 0 * half, 0 * half])
    m = task.measure(read)
    over = task.reward_terms(m, "shaped")["over"]
    np.testing.assert_allclose(over, [1, 1, (np.cos(np.pi / 6) - 0.77) / 0.18, 0])
    m["inside"] = np.ones(4, bool)
    assert task.reward_terms(m, "shaped")["over"].tolist() == [1] * 4


def test_an_empty_closed_gripper_earns_half_of_reach() -> None:
    task = PickPlaceCan()
    m = stage_measures(task)
    m["gripper_closing"] = np.ones(9)
    reach = task.reward_terms(m, "shaped")["reach"]
    np.testing.assert_allclose(reach[:3], [0.5 * (1 - np.tanh(1)), 0.5, 1])


@pytest.mark.parametrize("cls", TASKS)
def test_milestones_come_one_after_the_other(cls) -> None:
    task = cls()
    flags = task.milestones(stage_measures(task))
    first = [int(np.argmax(flags[name])) for name in task.milestone_names]
    assert first == [1, 2, 4, 5, 5, 8]


def test_the_stock_reward_counts_from_the_highest_object() -> None:
    task, tanh = PickPlaceCan(), np.tanh
    m = stage_measures(task)
    weights = task.weights["stock"]
    stock = weighted_sum(task.reward_terms(m, "stock"), weights)
    far = 0.2 * (1 - tanh(5))
    lift = [0.35 + 0.15 * (1 - tanh(15 * below)) for below in (0.19, 0.11, 0)]
    first = [max(0.1 * (1 - tanh(2)), far), 0.1, *(each + far for each in lift)]
    np.testing.assert_allclose(stock, [*first, 0.7, 0.7, 0.7, 1])
    m["other_Cereal_pos"][:, 2] = 5.0
    stock = weighted_sum(task.reward_terms(m, "stock"), weights)
    np.testing.assert_allclose(stock[2:5], 0.5 + far)


@pytest.mark.parametrize("cls", TASKS)
def test_boxes_are_those_of_the_meshes(cls, scene_of) -> None:
    task = cls()
    model, item = scene_of(task).physics, ITEMS[cls.item]
    (geom,) = np.flatnonzero(model.geom_bodyid == model.body(f"{cls.item}_main").id)
    mesh, turn = model.geom_dataid[geom], np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    points = model.mesh_vert[start : start + count] @ turn.reshape(3, 3).T
    points += model.geom_pos[geom]
    np.testing.assert_allclose(points.min(axis=0), item.low, atol=1e-3)
    np.testing.assert_allclose(points.max(axis=0), item.high, atol=1e-3)


@pytest.mark.parametrize("cls", TASKS)
def test_objects_start_where_documented(cls, scene_of) -> None:
    task, env_ids = cls(), np.arange(500)
    scene = scene_of(task)
    qpos = task.sample_start(scene, EpisodeStreams(0, env_ids, env_ids)).qpos
    others = {name: qpos[:, scene.free_qpos(f"{name}_main")] for name in ITEMS}
    own, item = others.pop(cls.item), ITEMS[cls.item]
    spread = np.array([0.145, 0.195]) - item.radius
    inside = np.abs(own[:, :2] - [0.1, -0.25]).max(axis=0)
    assert (inside <= spread).all()
    np.testing.assert_allclose(inside, spread, atol=0.003)
    np.testing.assert_allclose(own[:, 2], 0.8 + item.stand)
    parked = np.tile([10.0, 10, 10, 1, 0, 0, 0], (500, 1))
    for other in others.values():
        np.testing.assert_array_equal(other, parked)


def test_the_floor_holds_parked_objects_in_exact_physics_only(scene_of) -> None:
    task, height = PickPlaceCan(), {}
    for fidelity in "exact", "fast":
        engine = BatchEngine(scene_of(task, fidelity=fidelity), 1)
        start = task.sample_start(engine.scene, EpisodeStreams(0, [0], [0]))
        engine.reset(np.arange(1), *start)
        for _ in range(50):
            engine.step(np.zeros((1, 7)))
        height[fidelity] = engine.read()["other_Milk_pos"][0, 2]
        assert engine.read()["object_pos"][0, 2] == pytest.approx(0.86, abs=2e-3)
    assert 0 < height["exact"] < 0.1
    assert height["fast"] < -1
