"""Waypoints of tasks of several objects or stages: what is done stays done."""

from collections.abc import Callable, Iterator
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from manip.envs import waypoint_states
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Task, Waypoint
from manip.envs.task_registry import load_task
from manip.envs.time_step import TimeStep
from manip.envs.waypoint_states import WaypointMaker
from manip.sim.engine import Snapshot
from manip.sim.scene import Scene
from manip.tasks.one_at_a_time import OneAtATime

Array = np.ndarray

NUMBER = 4
"""States of each waypoint."""
CASES = [
    ("NutAssembly", "on_peg"),
    ("NutAssembly", "one"),
    ("PickPlace", "across"),
    ("PickPlace", "two"),
    ("Stack", "aligned"),
    ("Stack", "on"),
    ("ToolHang", "insert"),
    ("ToolHang", "hang"),
]
SEVERAL = [case for case in CASES if case[0] in ("NutAssembly", "PickPlace")]


class Made(NamedTuple):
    """States of a waypoint, and where they are 20 control steps later."""

    first: Snapshot
    again: Snapshot
    step: TimeStep
    measures: Measures


@pytest.fixture(scope="module")
def made(scene_of) -> Iterator[Callable[[str, str], Made]]:
    """A function that generates the states of a task's waypoint, once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(waypoint_states, "CANDIDATES", 8)
        scene = cache(lambda name: scene_of(load_task(name), fidelity="fast"))
        maker = cache(lambda name: WaypointMaker(load_task(name), scene(name), 0, 1))

        @cache
        def made(name: str, waypoint: str) -> Made:
            first, again = (maker(name).make(waypoint, NUMBER)[0] for _ in range(2))
            return Made(first, again, *held(load_task(name), scene(name), first))

        yield made


def held(task: Task, scene: Scene, snapshot: Snapshot) -> tuple[TimeStep, Measures]:
    """The last of 20 control steps in which arm and gripper wait, and its measures."""
    batch = NativeBatch(task, NUMBER, scene=scene, threads=1)
    batch.begin(np.arange(NUMBER))
    batch.engine.restore(snapshot)
    action = np.zeros((NUMBER, batch.action_dim))
    action[:, -1] = np.sign(batch.engine.read()["gripper_closing"])
    for _ in range(20):
        step = batch.step(action)
    return step, task.measure(batch.engine.read())


@pytest.mark.parametrize(("name", "waypoint"), CASES)
def test_states_last_short_of_success_and_depend_on_the_seed(
    name: str, waypoint: str, made
) -> None:
    states = made(name, waypoint)
    np.testing.assert_array_equal(states.first.states, states.again.states)
    assert states.step.milestones[waypoint].all()
    assert not states.step.success.any()


@pytest.mark.parametrize(("name", "waypoint"), SEVERAL)
def test_the_first_objects_stay_done_and_the_next_is_active(
    name: str, waypoint: str, made
) -> None:
    m = made(name, waypoint).measures
    number = m["done"].sum(axis=1)
    np.testing.assert_array_equal(m["active"], number)
    np.testing.assert_array_equal(
        m["done"], np.arange(m["done"].shape[1]) < number[:, None]
    )


def drawn(task: OneAtATime, scene: Scene, milestone: str) -> tuple[Array, Waypoint]:
    """qpos of 400 starts, and the waypoints that are drawn from the same streams."""
    ids = np.arange(400)
    start = task.sample_start(scene, EpisodeStreams(0, ids, ids)).qpos
    return start, task.sample_waypoint(milestone, scene, EpisodeStreams(0, ids, ids))


@pytest.mark.parametrize("name", ["NutAssembly", "PickPlace"])
def test_any_number_of_objects_is_done_and_the_others_are_at_their_starts(
    name: str, scene_of
) -> None:
    task = load_task(name)
    scene = scene_of(task, fidelity="fast")
    start, waypoint = drawn(task, scene, "lift")
    bodies = [scene.free_qpos(part.body) for part in task.parts.values()]
    qpos = waypoint.start.qpos
    moved = np.stack([(qpos[:, b] != start[:, b]).any(axis=1) for b in bodies], axis=1)
    number = moved.sum(axis=1)  # those that are done, and the one in the hand
    np.testing.assert_array_equal(moved, np.arange(len(bodies)) < number[:, None])
    shares = np.bincount(number, minlength=len(bodies) + 1)[1:] / 400
    np.testing.assert_allclose(shares, 1 / len(bodies), atol=0.1)
    rows = np.arange(400)
    grip = np.stack([qpos[:, b][:, :3] for b in bodies], axis=1)[rows, number - 1]
    assert (np.linalg.norm(waypoint.tool_pos - grip, axis=1) < 0.1).all()


def test_counts_are_of_objects_in_their_places_and_the_hand_is_open(scene_of) -> None:
    task = load_task("PickPlace")
    scene = scene_of(task, fidelity="fast")
    start, waypoint = drawn(task, scene, "three")
    moved = [
        (waypoint.start.qpos[:, b] != start[:, b]).any(axis=1).mean()
        for b in (scene.free_qpos(part.body) for part in task.parts.values())
    ]
    assert moved == [1, 1, 1, 0]
    assert not waypoint.closed
