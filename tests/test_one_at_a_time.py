"""Tasks with several objects: which is active, and what is paid."""

import numpy as np

from manip.rewards.compose import weighted_sum
from manip.tasks.nut_assembly import NutAssemblyRound
from manip.tasks.nut_assembly_both import NutAssembly

Array = np.ndarray

SQUARE_PEG, ROUND_PEG = np.array([0.23, 0.1, 0.85]), np.array([0.23, -0.1, 0.85])
DOWNWARDS = np.array([0.0, 1, 0, 1, 0, 0, 0, 0, -1])
"""A tool that points down, its fingers closing along y."""
HANDLE = np.array([0.06, 0.0, 0.0])


def readings() -> dict[str, Array]:
    """Readings of five stages: both nuts lie, the round one in the hand; the square one
    on its peg; then the round one in the hand as well; both on their pegs.
    """
    lying = np.array([[-0.1, 0.2, 0.83], [-0.1, -0.2, 0.83]])
    square = np.array([lying[0], lying[0], *[[*SQUARE_PEG[:2], 0.83]] * 3])
    round_nut = np.array([*[lying[1]] * 4, [*ROUND_PEG[:2], 0.83]])
    held = np.array([0.0, 1, 0, 1, 0])
    far = np.array([0.0, 0, 0.5])
    read = {
        "eef_pos": np.where(held[:, None], round_nut + HANDLE, round_nut + far),
        "eef_mat": np.tile(DOWNWARDS, (5, 1)),
        "gripper_closing": 2 * held - 1,
    }
    for name, nut, peg, touch in (
        ("Square", square, SQUARE_PEG, 0 * held),
        ("Round", round_nut, ROUND_PEG, held),
    ):
        read |= {
            f"{name}_nut_pos": nut,
            f"{name}_nut_quat": np.tile([1.0, 0, 0, 0], (5, 1)),
            f"{name}_peg_pos": np.tile(peg, (5, 1)),
            f"{name}_handle_pos": nut + HANDLE,
            f"{name}_left_touch": touch,
            f"{name}_right_touch": touch,
        }
    return read


def test_the_object_in_the_hand_is_active_or_the_first_that_is_not_done() -> None:
    task = NutAssembly()
    m = task.measure(readings())
    assert m["active"].tolist() == [0, 1, 1, 1, 0]
    assert m["done"].tolist() == [[0, 0], [0, 0], [1, 0], [1, 0], [1, 1]]
    assert task.success(m).tolist() == [False] * 4 + [True]
    flags = task.milestones(m)
    assert flags["one"].tolist() == [False, False, True, True, True]
    assert flags["both"].tolist() == [False] * 4 + [True]


def test_measures_are_those_of_the_active_object() -> None:
    task, read = NutAssembly(), readings()
    m, each = task.measure(read), task.each(read)
    for row, active in enumerate(m["active"]):
        for name in "to_handle", "aside", "fits", "grasped":
            np.testing.assert_array_equal(m[name][row], each[active][name][row])


def test_the_shaped_reward_counts_what_is_done() -> None:
    task, alone = NutAssembly(), NutAssemblyRound()
    m, weights = task.measure(readings()), task.weights["shaped"]
    shaped = weighted_sum(task.reward_terms(m, "shaped"), weights)
    of_round = weighted_sum(alone.reward_terms(task.each(m)[1], "shaped"), weights)
    assert shaped[0] < of_round[1] / 2
    np.testing.assert_allclose(shaped[1], of_round[1] / 2)
    np.testing.assert_allclose(shaped[2:4], (1 + of_round[2:4]) / 2)
    np.testing.assert_allclose(shaped[4], 1)


def test_the_stock_grasp_is_of_any_objects_that_are_not_done() -> None:
    task, read = NutAssembly(), readings()
    far = 0.2 * (1 - np.tanh(10 * np.hypot(0.33, 0.1)))
    grasp = 0.35 + 0.15 * (1 - np.tanh(15 * (0.995 - 0.83)))
    read["Square_left_touch"], read["Round_left_touch"] = (
        read["Round_left_touch"],
        read["Square_left_touch"],
    )
    m = task.measure(read)
    stock = weighted_sum(task.reward_terms(m, "stock"), task.weights["stock"])
    reach = 0.1
    expected = [far / 2, (grasp + far) / 2, (1 + far) / 2, (1 + reach) / 2, 1]
    np.testing.assert_allclose(stock, expected)
