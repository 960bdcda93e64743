"""Door, Lift and Stack: their rewards, in the numbers of their docstrings."""

import numpy as np

from manip.rewards.compose import weighted_sum
from manip.tasks.door import Door
from manip.tasks.lift import Lift
from manip.tasks.stack import Stack
from manip.tasks.wipe_rewards import shaped_terms


def test_door_pays_as_documented() -> None:
    handle = np.tile([0.0, -0.25, 1.07], (6, 1))
    read = {
        "handle_pos": handle,
        "eef_pos": handle + np.outer([0.2, 0, 0, 0, 0, 0.2], [0, 1, 0]),
        "handle_qpos": np.array([[0, 0.6, -1.2, 0, 0, 0]]).T,
        "hinge_qpos": np.array([[0, 0, 0, 0.101, 0.29, 0.35]]).T,
        "door_turn": np.tile([1.0, 0, 0, 0], (6, 1)),
    }
    task = Door()
    m = task.measure(read)
    shaped = weighted_sum(task.reward_terms(m, "shaped"), task.weights["shaped"])
    far = 1 - np.tanh(1)
    level = [0.1 * far, 0.1 + 0.1, 0.1 + 0.2]
    ajar = [0.3 + 0.4 * 0.101 / 0.35, 0.3 + 0.4 * 0.29 / 0.35, 1]
    np.testing.assert_allclose(shaped, level + ajar)
    assert task.success(m).tolist() == [False] * 5 + [True]
    stock = weighted_sum(task.reward_terms(m, "stock"), task.weights["stock"])
    turned = [0.25 + 0.25 * angle / (np.pi / 2) for angle in (0.6, 1.2)]
    expected = [0.25 * (1 - np.tanh(2)), *turned, 0.25, 0.25, 1]
    np.testing.assert_allclose(stock, expected)


def test_stack_pays_as_documented_and_more_each_stage() -> None:
    b, above = np.array([0.1, 0.0, 0.825]), 0.045
    lying, lifted = [-0.1, 0.0, 0.82], [-0.1, 0.0, 0.845]
    offsets = [[0, 0, above + 0.05], [0, 0, above + 0.001], *[[0, 0, above]] * 3]
    a = np.vstack([[lying] * 3, lifted, b + offsets])
    far, closing = [0.2, *[0.0] * 7, 0.06], [-1, -1, 1, 1, 1, 1, 1, 0, -1]
    read = {
        "a_pos": a,
        "b_pos": np.tile(b, (9, 1)),
        "eef_pos": a + np.outer(far, [0, 0, 1]),
        "left_touch": np.array([0.0, 0, 1, 1, 1, 1, 1, 1, 0]),
        "right_touch": np.array([0.0, 1, 1, 1, 1, 1, 1, 1, 0]),
        "cubes_touch": np.array([0.0, 0, 0, 0, 0, 0, 1, 1, 1]),
        "gripper_closing": np.array(closing, dtype=float),
    }
    task = Stack()
    m = task.measure(read)
    shaped = weighted_sum(task.reward_terms(m, "shaped"), task.weights["shaped"])
    aside, tanh = 0.2, np.tanh
    half_up = 0.16 + 0.04 + 0.08 * (1 - tanh(6 * aside))
    held = [0.08 * (1 - tanh(1)), 0.08, 0.16, half_up, 0.4, 0.4 + 0.1176]
    np.testing.assert_allclose(shaped, [*held, 0.57, 0.635, 1])
    assert (np.diff(shaped) > 0).all()
    assert task.success(m).tolist() == [False] * 8 + [True]
    stock = weighted_sum(task.reward_terms(m, "stock"), task.weights["stock"])
    low = [0.125 * (1 - tanh(2)), 0.125, 0.25, 0.5 + 0.25 * (1 - tanh(aside))]
    np.testing.assert_allclose(stock, [*low, *[0.75] * 4, 1])


def test_lift_pays_as_documented() -> None:
    height = np.array([0.021, 0.021, 0.0399, 0.0401, 0.2, 0.021, 0.2])
    cube = np.outer(0.8 + height, [0, 0, 1])
    above = [0.2, 0, 0, 0, 0.012, 0.018, 0.021]
    tilt = np.array([0, 0.1, 0.2, 0.3, 0.5, 1.0, 3.0])
    eef_mat = np.zeros((7, 9))
    eef_mat[:, [2, 5, 8]] = np.stack([np.sin(tilt), 0 * tilt, -np.cos(tilt)], axis=1)
    read = {
        "cube_pos": cube,
        "eef_mat": eef_mat,
        "eef_pos": cube + np.outer(above, [0, 0, 1]),
        "left_touch": np.array([1.0, 0, 1, 1, 1, 1, 1]),
        "right_touch": np.array([0.0, 0, 1, 1, 1, 1, 1]),
        "gripper_closing": np.ones(7),
    }
    task = Lift()
    m = task.measure(read)
    terms = task.reward_terms(m, "shaped")
    np.testing.assert_allclose(terms["reach"], 1 - np.tanh(5 * np.array(above)))
    np.testing.assert_allclose(terms["grasp"], [0, 0, 1, 1, 1, 0.25, 0], atol=1e-9)
    np.testing.assert_allclose(terms["lift"], [0, 0, 0.378, 0.382, 1, 0, 1], atol=1e-9)
    upright = [1, 1, 0.75, 0.5, 0, 0, 0]
    np.testing.assert_allclose(terms["upright"], upright, atol=1e-9)
    assert task.success(m).tolist() == [False] * 3 + [True] * 2 + [False, True]
    stock = weighted_sum(task.reward_terms(m, "stock"), task.weights["stock"])
    low = (1.25 - np.tanh(0.18)) / 2.25
    expected = [(1 - np.tanh(2)) / 2.25, 1 / 2.25, 1.25 / 2.25, 1, 1, low, 1]
    np.testing.assert_allclose(stock, expected)


def test_wipe_pays_less_the_harder_the_wiper_presses() -> None:
    force = np.array([0.0, 20, 30, 40, 60, 110, 10, 110])
    clean = np.arange(8) == 7
    m = {
        "force": np.outer(force, [0, 0, -1]),
        "contacts": np.array([4.0, 4, 4, 4, 4, 4, 0, 4]),
        "distance": np.linspace(0, 0.3, 8),
        "share": np.linspace(0, 1, 8),
    }
    terms = shaped_terms(m, clean)
    touch = [1, 1, 0.75, 0.5, 0, 0, 0, 1]
    np.testing.assert_allclose(terms["touch"], touch, atol=1e-9)
    near = np.where(clean, 1, 1 - np.tanh(5 * m["distance"]))
    np.testing.assert_allclose(terms["near"], near)
    np.testing.assert_allclose(terms["wiped"], m["share"])
    assert terms["clean"].tolist() == clean.tolist()
