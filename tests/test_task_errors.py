"""Mistakes of a user's task give one-line errors when it is built."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task import Start, Task
from manip.envs.task_batch import TimeStep
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


Method = Callable[..., Any]

MISTAKES: dict[str, tuple[str, Method]] = {
    "measure() returns NoneType, not named arrays": (
        "measure",
        lambda task, read: None,
    ),
    "measure(): unknown measure 'buton_pos': did you mean 'button_pos'? known": (
        "measure",
        lambda task, read: {**read, "place": read["buton_pos"]},
    ),
    "observe() part 'depth' has shape (3,), not (3, k): a row per environment": (
        "observe",
        lambda task, m: {"depth": m["depth"]},
    ),
    "observe() part 'rest' has shape (1, 7), not (3, k): a row per environment": (
        "observe",
        lambda task, m: {"arm": m["joint_pos"], "rest": m["rest_pos"]},
    ),
    "observe() part 'down' holds bool, not floating-point numbers": (
        "observe",
        lambda task, m: {"down": m["depth"][:, None] > 0},
    ),
    "observe() part 'zero' holds list, not floating-point numbers": (
        "observe",
        lambda task, m: {"zero": [[0.0]] * 3},
    ),
    "observe() returns no numbers, so a policy cannot act on it": (
        "observe",
        lambda task, m: {},
    ),
    "reward_terms(m, 'shaped') returns 'near', but weights['shaped'] has 'near', ": (
        "reward_terms",
        lambda task, m, reward: {"near": m["distance"]},
    ),
    "reward_terms(m, 'shaped') term 'press' has shape (3, 1), not (3,)": (
        "reward_terms",
        lambda task, m, reward: {"near": m["distance"], "press": m["button_qpos"]},
    ),
    "success() holds float64, not bool": ("success", lambda task, m: m["depth"]),
    "success() has shape (3, 1), not (3,)": (
        "success",
        lambda task, m: m["button_qpos"] > 0,
    ),
    "failure() has shape (), not (3,)": ("failure", lambda task, m: None),
    "update_memory() returns 'pushed', but sensors.memory has nothing": (
        "update_memory",
        lambda task, m: {"pushed": m["button_qpos"]},
    ),
    "milestones() returns 'near', 'push', but milestone_names has 'near', 'press'": (
        "milestones",
        lambda task, m: dict.fromkeys(["near", "push"], m["depth"] > 0),
    ),
    "milestones() 'near' holds float64, not bool": (
        "milestones",
        lambda task, m: dict.fromkeys(task.milestone_names, m["depth"]),
    ),
    "sample_start() returns ndarray, not Start(qpos, fields)": (
        "sample_start",
        lambda task, scene, streams: scene.layout.qpos,
    ),
    "sample_start() qpos has shape (10,), not (2, 10)": (
        "sample_start",
        lambda task, scene, streams: Start(scene.layout.qpos),
    ),
    "sample_start(): unknown field 'socket': did you mean 'socket_place'? known": (
        "sample_start",
        lambda task, scene, streams: Start(at_rest(scene, 2), {"socket": 0.0}),
    ),
    "sample_start() field 'socket_place' has shape (3,), not (2, 3)": (
        "sample_start",
        lambda task, scene, streams: Start(
            at_rest(scene, 2), {"socket_place": np.zeros(3)}
        ),
    ),
}
"""Error message -> the method that is wrong, and its body."""


def at_rest(scene: Scene, episodes: int) -> np.ndarray:
    return np.tile(scene.layout.qpos, (episodes, 1))


@pytest.mark.parametrize("message", MISTAKES)
def test_a_wrong_part_is_an_error_when_the_environments_are_built(
    message: str, press: Task, scene: Scene
) -> None:
    method, body = MISTAKES[message]
    wrong = type("Mine", (type(press),), {method: body})()
    with pytest.raises(UserError) as error:
        NativeBatch(wrong, 3, scene=scene, threads=1)
    assert str(error.value).startswith(f"task 'Mine': {message}")
    assert "\n" not in str(error.value)


def fails(task: Task, m: Any) -> Any:
    raise ArithmeticError("so\nsad")


@pytest.mark.parametrize("method", ["measure", "observe", "success", "update_memory"])
def test_an_error_inside_a_task_is_named_with_its_place(method, press, scene) -> None:
    wrong = type("Mine", (type(press),), {method: fails, "__module__": __name__})()
    line = fails.__code__.co_firstlineno + 1
    message = f"task 'Mine': ArithmeticError: so sad (test_task_errors.py, line {line})"
    with pytest.raises(UserError) as error:
        NativeBatch(wrong, 3, scene=scene, threads=1)
    assert str(error.value) == message


def test_an_error_in_a_later_step_is_named(press: Task, scene: Scene) -> None:
    wrong = type("Mine", (type(press),), {})()
    batch = NativeBatch(wrong, 3, scene=scene, threads=1)
    batch.begin(np.arange(3))
    wrong.observe = lambda m: 1 / 0
    with pytest.raises(UserError, match="task 'Mine': ZeroDivisionError"):
        batch.step(np.zeros((3, 7)))


PARTS = (
    *("measure", "observe", "reward_terms", "success", "failure", "update_memory"),
    *("milestones", "sample_start"),
    *("horizon", "weights", "milestone_names", "sensors"),
)

arrays = st.builds(
    np.full,
    st.sampled_from([(), (3,), (3, 1), (3, 7), (2, 10), (2,), (3, 0), (1, 3, 1)]),
    st.sampled_from([0.0, np.nan, np.inf, 1e39, 1, True, "x", None, 1j]),
)
names = st.sampled_from(["arm", "near", "press", "socket_place", "shaped", 3, ""])
anything = arrays | st.none() | st.integers(-1, 3) | st.just("near") | st.floats()
anything |= st.lists(anything, max_size=2) | st.dictionaries(names, anything)
given_back = anything | st.builds(Start, anything, st.dictionaries(names, anything))


def played(task: Task, scene: Scene) -> list[TimeStep] | str:
    """Two time steps of three environments, or the error message."""
    try:
        batch = NativeBatch(task, 3, scene=scene, threads=1)
        batch.begin(np.arange(3))
        return [batch.observe(), batch.step(np.zeros((3, 7)))]
    except UserError as error:
        return str(error)


def assert_right_or_refused(part: str, value: Any, press: Task, scene: Scene) -> None:
    data = part in ("horizon", "weights", "milestone_names", "sensors")
    body = value if data else lambda task, *given: value
    steps = played(type("Odd", (type(press),), {part: body})(), scene)
    if isinstance(steps, str):
        assert "\n" not in steps
        return
    for time_step in steps:
        assert time_step.observation.dtype == np.float32
        assert np.isfinite(time_step.observation).all()
        assert time_step.reward.shape == (3,)
        assert np.isfinite(time_step.reward).all()
        assert time_step.done.dtype == time_step.success.dtype == bool


patient = settings(
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


@settings(patient, max_examples=80, derandomize=True)
@given(part=st.sampled_from(PARTS), value=given_back)
def test_any_result_of_a_task_is_right_or_refused_in_one_line(
    part: str, value: Any, press: Task, scene: Scene
) -> None:
    assert_right_or_refused(part, value, press, scene)


@pytest.mark.slow
@settings(patient, max_examples=2000)
@given(part=st.sampled_from(PARTS), value=given_back)
def test_thousands_of_odd_results_are_right_or_refused(
    part: str, value: Any, press: Task, scene: Scene
) -> None:
    assert_right_or_refused(part, value, press, scene)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("class Odd(", "SyntaxError: '(' was never closed (odd.py, line 1)"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("import sys; sys.exit(0)", "SystemExit: 0"),
    ],
)
def test_a_module_that_cannot_be_imported_is_an_error(
    source: str, message: str, tmp_path: Path, monkeypatch
) -> None:
    (tmp_path / "odd.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UserError) as error:
        load_task("odd:Odd")
    assert str(error.value) == f"cannot import task 'odd:Odd': {message}"


def test_a_task_without_its_attributes_is_refused(press: Task, monkeypatch) -> None:
    bare = type("Bare", (Task,), {"name": "bare", "milestones": ("near",)})
    monkeypatch.setattr(sys.modules["press"], "Bare", bare, raising=False)
    missing = "measure, .*, success, robosuite_name, sensors, .*, milestone_names$"
    with pytest.raises(UserError, match=f"'press:Bare' does not define {missing}"):
        load_task("press:Bare")
