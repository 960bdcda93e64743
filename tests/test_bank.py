"""Starts in states that the worlds have been in before."""

import numpy as np

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.restart_buffer import CAPACITY, RestartBuffer
from manip.sim.batch_engine import Snapshot
from manip.sim.scene import Scene
from manip.tasks.lift import Lift

DOWN = np.array([0.0, 0, -1, 0, 0, 0, -1])
"""Action [A]: towards the table, gripper open."""


class Descend(Lift):
    """A stage that going down reaches."""

    milestone_names = ("low", "lift")

    def milestones(self, m):
        return {"low": m["eef_pos"][:, 2] < 0.9, "lift": self.success(m)}


def snapshot(values: list[float]) -> Snapshot:
    column = np.array(values)[:, None]
    return Snapshot(column, 10 * column)


def drawn(bank: RestartBuffer, number: int = 300) -> np.ndarray:
    """States [number] that the bank gives, whose readings fit them."""
    worlds = np.arange(number)
    found = bank.draw(EpisodeStreams(0, worlds, worlds))
    np.testing.assert_array_equal(found.readings, 10 * found.states)
    return found.states[:, 0]


def test_a_state_is_kept_by_its_last_stage_unless_none_or_all_is_done() -> None:
    bank = RestartBuffer(3, snapshot([0]))
    assert bank.empty
    reached = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [1, 1, 1]])
    bank.keep(snapshot([1, 2, 3, 4, 5]), reached.astype(bool))
    bank.keep(snapshot([6]), np.array([[True, False, False]]))
    states, count = np.unique(drawn(bank), return_counts=True)
    assert states.tolist() == [2, 3, 4, 6]
    assert (np.abs(count - 75) < 30).all()


def test_stages_are_drawn_alike_whatever_they_hold() -> None:
    bank = RestartBuffer(3, snapshot([0]))
    bank.keep(snapshot([7]), np.array([[True, True, False]]))
    for value in range(20):
        bank.keep(snapshot([20 + value]), np.array([[True, False, False]]))
    assert abs((drawn(bank) == 7).mean() - 0.5) < 0.1


def test_the_latest_states_are_kept() -> None:
    bank = RestartBuffer(2, snapshot([0]))
    for value in range(CAPACITY + 50):
        bank.keep(snapshot([value]), np.array([[True, False]]))
    assert drawn(bank, 5000).min() >= 50


def heights(worlds: NativeBatch, steps: int) -> np.ndarray:
    """Of the tools [steps, N] m, as every world goes down again and again."""
    worlds.begin(np.arange(worlds.num_envs))
    found = []
    for _ in range(steps):
        over = worlds.step(np.tile(DOWN, (worlds.num_envs, 1))).done
        worlds.begin(np.flatnonzero(over))
        found.append(worlds.read()["eef_pos"][:, 2].copy())
    return np.array(found)


def descending(scene: Scene, restart_fraction: float) -> NativeBatch:
    return NativeBatch(
        Descend(),
        4,
        scene=scene,
        horizon=30,
        threads=1,
        restart_fraction=restart_fraction,
    )


def test_episodes_begin_where_earlier_ones_have_been(lift_scene) -> None:
    plain = heights(descending(lift_scene, 0.0), 61)
    own = heights(descending(lift_scene, 1.0), 61)
    np.testing.assert_array_equal(own[:29], plain[:29])
    assert (plain[[29, 59]] > 0.95).all()
    assert (own[[29, 59]] < 0.9).all()


def test_the_bank_is_part_of_the_state(lift_scene) -> None:
    first, second = [descending(lift_scene, 0.5) for _ in range(2)]
    heights(first, 70)
    second.load_state(first.save_state())
    np.testing.assert_array_equal(heights(first, 70), heights(second, 70))
