"""A task that changes or exits in mid-run is an error."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.errors import UserError
from manip.sim.scene import Scene

ROOT = Path(__file__).parents[1]
PAGE, FOLDER = ROOT / "docs/own-task.md", ROOT / "docs/own_task"


@pytest.fixture(autouse=True, scope="module")
def _in_the_folder() -> Iterator[None]:
    """Work in the folder of the module, without installing it, as a user does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", list(sys.path))
        patch.chdir(FOLDER)
        yield


@pytest.fixture(scope="module")
def press() -> Task:
    return load_task("press:Press")


@pytest.fixture(scope="module")
def scene(press: Task, scene_of) -> Scene:
    return scene_of(press)


def parts_of(m: Any) -> dict[str, Any]:
    return {"to_button": m["to_button"], "depth": m["depth"][:, None]}


CHANGES: dict[str, tuple[str, Callable[..., Any]]] = {
    "observe() part 'depth' was float64 [3, 1] at first, and is now float64 [3]": (
        "observe",
        lambda m: parts_of(m) | {"depth": m["depth"]},
    ),
    "observe() part 'depth' was float64 [3, 1] at first, and is now float64 [3, 2]": (
        "observe",
        lambda m: parts_of(m) | {"depth": np.stack([m["depth"]] * 2, axis=1)},
    ),
    "observe() part 'depth' was float64 [3, 1] at first, and is now missing": (
        "observe",
        lambda m: {"to_button": m["to_button"]},
    ),
    "observe() part 'more' was missing at first, and is now ": (
        "observe",
        lambda m: parts_of(m) | {"more": m["to_button"]},
    ),
    "observe() part 'depth' was float64 [3, 1] at first, and is now no array": (
        "observe",
        lambda m: parts_of(m) | {"depth": [[0.0]] * 3},
    ),
    "observe() gave its parts in the order to_button, depth at first, "
    "and now depth, to_button": (
        "observe",
        lambda m: dict(reversed(parts_of(m).items())),
    ),
    "reward term 'press' was float64 [3] at first, and is now bool [3]": (
        "reward_terms",
        lambda m, reward: {"near": m["depth"], "press": m["depth"] > 0},
    ),
    "reward term 'press' was float64 [3] at first, and is now missing": (
        "reward_terms",
        lambda m, reward: {"near": m["depth"]},
    ),
    "milestone 'near' was bool [3] at first, and is now float64 [3]": (
        "milestones",
        lambda m: {"near": m["depth"], "press": m["depth"] > 1},
    ),
    "result of 'success()' was bool [3] at first, and is now float64 [3]": (
        "success",
        lambda m: m["depth"],
    ),
    "result of 'failure()' was bool [3] at first, and is now no array": (
        "failure",
        lambda m: False,
    ),
}
"""Error message -> the method that changes in mid-run, and its new body."""


@pytest.mark.parametrize("message", CHANGES)
def test_a_task_that_changes_in_mid_run_is_an_error(
    message: str, press: Task, scene: Scene
) -> None:
    """A learner would go on with other numbers, or with the same in other places."""
    task = type("Mine", (type(press),), {"observe": lambda self, m: parts_of(m)})()
    batch = NativeBatch(task, 3, scene=scene, threads=1)
    batch.begin(np.arange(3))
    batch.step(np.zeros((3, 7)))
    method, body = CHANGES[message]
    setattr(task, method, body)
    with pytest.raises(UserError) as error:
        batch.step(np.zeros((3, 7)))
    assert str(error.value).startswith(f"task 'Mine': {message}")


def test_memory_that_changes_in_mid_run_is_an_error(press: Task, scene_of) -> None:
    """A backend could broadcast it, or lose it."""
    memory = {"depth_before": 1}
    task = type(
        "Mine",
        (type(press),),
        {
            "sensors": replace(press.sensors, memory=memory),
            "update_memory": lambda self, m: {"depth_before": m["depth"][:, None]},
        },
    )()
    scene = scene_of(task)
    batches = [
        NativeBatch(task, 3, scene=scene, threads=1),
        StockBatch(task, stock=scene.stock),
    ]
    for batch in batches:
        batch.begin(np.arange(batch.num_envs))
    task.update_memory = lambda m: {"depth_before": m["depth"]}
    for batch in batches:
        with pytest.raises(UserError, match="'depth_before' has shape"):
            batch.step(np.zeros((batch.num_envs, 7)))
    task.update_memory = lambda m: {}
    for batch in batches:
        with pytest.raises(UserError, match=r"update_memory.* returns nothing, but"):
            batch.step(np.zeros((batch.num_envs, 7)))


class Leave(BaseException):
    """An exception that is no Exception, as pytest's and asyncio's are."""


@pytest.mark.parametrize("leaving", [SystemExit(0), SystemExit(), Leave("now")])
@pytest.mark.parametrize("method", ["measure", "observe", "sample_start", "success"])
def test_a_task_that_exits_is_an_error(
    method: str, leaving: BaseException, press: Task, scene: Scene
) -> None:
    """sys.exit(0) would end a run with exit code 0 and nothing saved."""

    def leave(*_: Any) -> None:
        raise leaving

    task = type("Mine", (type(press),), {})()
    batch = NativeBatch(task, 3, scene=scene, threads=1, horizon=1)
    batch.begin(np.arange(3))
    setattr(task, method, leave)
    call = batch.begin if method == "sample_start" else batch.step
    argument = np.arange(3) if method == "sample_start" else np.zeros((3, 7))
    with pytest.raises(UserError, match=f"task 'Mine': {type(leaving).__name__}"):
        call(argument)
    with pytest.raises(UserError, match=f"task 'Mine': {type(leaving).__name__}"):
        NativeBatch(task, 3, scene=scene, threads=1)


def test_weights_of_the_shaped_set_sum_to_at_most_1(press: Task, scene: Scene) -> None:
    weights = {"shaped": {"near": 0.5, "press": 0.6}}
    task = type("Mine", (type(press),), {"weights": weights})()
    with pytest.raises(UserError, match=r"weights\['shaped'\] sum to 1.1: they must"):
        NativeBatch(task, 3, scene=scene, threads=1)
    high = type(
        "Mine",
        (type(press),),
        {
            "reward_terms": lambda task, m, reward: {
                "near": 3.0 + 0 * m["depth"],
                "press": 0 * m["depth"],
            }
        },
    )()
    batch = NativeBatch(high, 3, scene=scene, threads=1)
    batch.begin(np.arange(3))
    with pytest.warns(UserWarning, match="task 'Mine': a step pays from 1.2 to 1.2"):
        batch.observe()
    overrides = {"near": 2.0, "press": 3.0}  # a user's own
    batch = NativeBatch(press, 3, scene=scene, threads=1, reward_weights=overrides)
    assert batch.reward_weights == overrides
