"""Starts in previously visited states."""

import numpy as np
import pytest

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.restart_buffer import CAPACITY, RestartBuffer
from manip.errors import UserError
from manip.sim.engine import Snapshot
from manip.sim.scene import Scene
from manip.tasks.lift import Lift

Array = np.ndarray

DOWN = np.array([0.0, 0, -1, 0, 0, 0, -1])
"""Action [A]: towards the table, gripper open."""


class Descend(Lift):
    """Lift with a milestone that going down reaches."""

    milestone_names = ("low", "lift")

    def milestones(self, m):
        return {"low": m["eef_pos"][:, 2] < 0.9, "lift": self.success(m)}


def snapshot(values: list[float]) -> Snapshot:
    column = np.array(values)[:, None]
    return Snapshot(column, 10 * column)


def drawn(buffer: RestartBuffer, number: int = 300) -> Array:
    """Draw states [number]; their readings must belong to them."""
    env_ids = np.arange(number)
    states = buffer.draw(EpisodeStreams(0, env_ids, env_ids))
    np.testing.assert_array_equal(states.readings, 10 * states.states)
    return states.states[:, 0]


def test_a_state_is_stored_under_its_last_milestone() -> None:
    buffer = RestartBuffer(3, snapshot([0]))
    assert buffer.empty
    reached = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [1, 1, 1]])
    buffer.store(snapshot([1, 2, 3, 4, 5]), reached.astype(bool))
    buffer.store(snapshot([6]), np.array([[True, False, False]]))
    states, count = np.unique(drawn(buffer), return_counts=True)
    assert states.tolist() == [2, 3, 4, 6]
    assert (np.abs(count - 75) < 30).all()


def test_milestones_are_drawn_with_equal_chance_for_any_number_of_states() -> None:
    buffer = RestartBuffer(3, snapshot([0]))
    buffer.store(snapshot([7]), np.array([[True, True, False]]))
    for value in range(20):
        buffer.store(snapshot([20 + value]), np.array([[True, False, False]]))
    assert abs((drawn(buffer) == 7).mean() - 0.5) < 0.1


def test_the_latest_states_are_stored() -> None:
    buffer = RestartBuffer(2, snapshot([0]))
    for value in range(CAPACITY + 50):
        buffer.store(snapshot([value]), np.array([[True, False]]))
    assert drawn(buffer, 5000).min() >= 50


@pytest.mark.parametrize("wrong", ["rows", "milestones", "count"])
def test_a_saved_state_of_another_shape_is_refused(wrong: str) -> None:
    buffer = RestartBuffer(3, snapshot([0]))
    state = buffer.save_state()
    if wrong == "rows":
        state["states"] = state["states"][:, :1]  # numpy would broadcast it
    elif wrong == "milestones":
        state = RestartBuffer(2, snapshot([0])).save_state()
    else:
        state["count"] = state["count"] - 1
    with pytest.raises(UserError, match="saved"):
        buffer.load_state(state)


def heights(batch: NativeBatch, steps: int) -> Array:
    """Heights of the tools [steps, N] m, as every environment goes down repeatedly."""
    batch.begin(np.arange(batch.num_envs))
    rows = []
    for _ in range(steps):
        done = batch.step(np.tile(DOWN, (batch.num_envs, 1))).done
        batch.begin(np.flatnonzero(done))
        rows.append(batch.read()["eef_pos"][:, 2].copy())
    return np.array(rows)


def descending(scene: Scene, restart_fraction: float) -> NativeBatch:
    return NativeBatch(
        Descend(),
        4,
        scene=scene,
        horizon=30,
        threads=1,
        restart_fraction=restart_fraction,
    )


def test_episodes_start_from_visited_states(lift_scene) -> None:
    plain = heights(descending(lift_scene, 0.0), 61)
    restarted = heights(descending(lift_scene, 1.0), 61)
    np.testing.assert_array_equal(restarted[:29], plain[:29])
    assert (plain[[29, 59]] > 0.95).all()
    assert (restarted[[29, 59]] < 0.9).all()


def test_the_buffer_is_part_of_the_saved_state(lift_scene) -> None:
    first, second = [descending(lift_scene, 0.5) for _ in range(2)]
    heights(first, 70)
    second.load_state(first.save_state())
    np.testing.assert_array_equal(heights(first, 70), heights(second, 70))
