"""NutAssembly: rewards and start states, in the numbers of its docstrings."""

import numpy as np
import pytest

from manip.envs.episode_streams import EpisodeStreams
from manip.rewards.compose import weighted_sum
from manip.tasks.nut_assembly import NutAssemblyRound, NutAssemblySquare, OneNut

PEG = np.array([0.23, 0.1, 0.85])
HANDLE = np.array([0.054, 0.0, 0.0])
DOWNWARDS = np.array([0.0, 1, 0, 1, 0, 0, 0, 0, -1])
"""A tool that points down, its fingers closing along y."""


def stage_measures(task: OneNut) -> dict[str, np.ndarray]:
    """Measures of nine stages: far, near, grasped, half up, above the peg, at its top,
    grasped on the peg, half opened there, down and released.
    """
    heights = [0.83, 0.83, 0.83, 0.90, 0.97, 0.96, 0.94, 0.94, 0.83]
    nut = np.tile(PEG, (9, 1)) - np.outer([0.3] * 4 + [0] * 5, [1, 0, 0])
    nut[:, 2] = heights
    touch = np.array([0.0, 0, 1, 1, 1, 1, 1, 1, 0])
    read = {
        "nut_pos": nut,
        "nut_quat": np.tile([1.0, 0, 0, 0], (9, 1)),
        "other_pos": np.tile([10.0, 10, 0.01], (9, 1)),
        "peg_pos": np.tile(PEG, (9, 1)),
        "handle_pos": nut + HANDLE,
        "eef_pos": nut + HANDLE + np.outer([0.2] + [0] * 8, [0, 0, 1]),
        "eef_mat": np.tile(DOWNWARDS, (9, 1)),
        "left_touch": touch,
        "right_touch": touch,
        "gripper_closing": np.array([-1.0, -1, 1, 1, 1, 1, 1, 0, -1]),
    }
    return task.measure(read)


@pytest.mark.parametrize("cls", [NutAssemblyRound, NutAssemblySquare])
def test_it_pays_as_documented_and_more_each_stage(cls) -> None:
    task, tanh = cls(), np.tanh
    m = stage_measures(task)
    shaped = weighted_sum(task.reward_terms(m, "shaped"), task.weights["shaped"])
    beside = 0.6 * (1 - 0.3 / 0.5) + 0.4 * (1 - tanh(10))
    half_up = 0.3 + 0.75 * (0.15 + 0.2 * beside)
    low = [0.1 * (1 - tanh(0.925)) + 0.05 * (1 - tanh(2)), 0.15, 0.3, half_up]
    top = [0.65, 0.65 + 0.02, 0.7 + 0.06, 0.7 + 0.06 + 0.0075, 1]
    np.testing.assert_allclose(shaped, low + top)
    assert (np.diff(shaped) > 0).all()
    assert task.success(m).tolist() == [False] * 8 + [True]
    flags = task.milestones(m)
    counts = np.sum([flags[name] for name in task.milestone_names], axis=0)
    assert counts.tolist() == [0, 1, 2, 3, 4, 4, 4, 4, 3]


def test_the_stock_reward_counts_from_the_higher_nut() -> None:
    task = NutAssemblySquare()
    m = stage_measures(task)
    tanh, far = np.tanh, 0.2 * (1 - np.tanh(3))
    lift = [0.35 + 0.15 * (1 - tanh(15 * (0.995 - z))) for z in (0.83, 0.9, 0.97)]
    first = [max(0.1 * (1 - tanh(2)), far), 0.1, lift[0] + far, lift[1] + far]
    weights = task.weights["stock"]
    stock = weighted_sum(task.reward_terms(m, "stock"), weights)
    np.testing.assert_allclose(stock[:5], [*first, lift[2] + 0.2])
    assert stock[-1] == 1
    m["other_pos"][:] = [10, 10, 5]
    stock = weighted_sum(task.reward_terms(m, "stock"), weights)
    np.testing.assert_allclose(stock[2:5], [0.5 + far, 0.5 + far, 0.7])


def test_a_square_nut_that_is_turned_earns_less_above_its_peg() -> None:
    turned = np.pi / 8
    over = {}
    for cls in NutAssemblyRound, NutAssemblySquare:
        task = cls()
        m = stage_measures(task)
        quat = np.tile([np.cos(turned / 2), 0, 0, np.sin(turned / 2)], (9, 1))
        terms = task.reward_terms(task.measure({**m, "nut_quat": quat}), "shaped")
        over[cls] = terms["over"][4]
    assert over[NutAssemblyRound] == pytest.approx(1)
    assert over[NutAssemblySquare] == pytest.approx(0.6 + 0.4 / 2)


@pytest.mark.parametrize("cls", [NutAssemblyRound, NutAssemblySquare])
def test_nuts_start_where_documented(cls, scene_of) -> None:
    task, env_ids = cls(), np.arange(500)
    scene = scene_of(task)
    qpos = task.sample_start(scene, EpisodeStreams(0, env_ids, env_ids)).qpos
    nut, other = (qpos[:, scene.free_qpos(body)] for body in (task.body, task.other))
    low, high = nut[:, :3].min(axis=0), nut[:, :3].max(axis=0)
    inner, outer = sorted([task.side * 0.11, task.side * 0.225])
    np.testing.assert_allclose(low, [-0.115, inner, 0.89], atol=1e-3)
    np.testing.assert_allclose(high, [-0.11, outer, 0.89], atol=1e-3)
    yaw = 2 * np.arctan2(nut[:, 6], nut[:, 3]) % (2 * np.pi)
    assert np.histogram(yaw, bins=12, range=(0, 2 * np.pi))[0].min() > 20
    np.testing.assert_array_equal(other, np.tile([10, 10, 10, 1, 0, 0, 0], (500, 1)))
