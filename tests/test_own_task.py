"""A user's own task: the documented example works, mistakes give one-line errors."""

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from twin import copy_start

from manip.agents.policy import load_policy
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.task import Start, Task
from manip.envs.task_batch import TimeStep
from manip.envs.task_registry import load_task, task_names
from manip.errors import UserError
from manip.evaluation import runners as evaluation
from manip.programs import cli, main
from manip.sim import gl
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
    sys.modules.pop("press", None)


@pytest.fixture(scope="module")
def press() -> Task:
    return load_task("press:Press")


@pytest.fixture(scope="module")
def scene(press: Task, scene_of) -> Scene:
    return scene_of(press)


def test_the_page_shows_the_file() -> None:
    blocks = re.findall("```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    shown, source = "".join(blocks), (FOLDER / "press.py").read_text()
    assert shown.split() == source.split()
    assert (FOLDER / "pyproject.toml").read_text() in PAGE.read_text()


def test_the_engine_does_what_stock_does(press: Task, scene: Scene) -> None:
    stock = StockBatch(press, stock=scene.stock)
    native = NativeBatch(press, 2, scene=scene, threads=1)
    stock.begin(np.arange(1))
    native.begin(np.arange(2))
    copy_start(press, native.engine, range(2))
    for _ in range(25):
        action = stock.expert().astype(np.float32)
        time_step, expected = native.step(action.repeat(2, 0)), stock.step(action)
        np.testing.assert_allclose(
            time_step.observation[:1], expected.observation, 0, 1e-4
        )
        np.testing.assert_allclose(time_step.reward[:1], expected.reward, 0, 1e-4)
        assert time_step.success[0] == expected.success == scene.stock._check_success()
    assert time_step.success.all()


def test_every_episode_can_be_solved(press: Task, scene: Scene) -> None:
    batch = NativeBatch(press, 8, scene=scene)
    batch.begin(np.arange(8))
    steps = [batch.step(batch.expert()) for _ in range(40)]
    assert not steps[0].success.any()
    assert np.all([time_step.success for time_step in steps[-10:]])


def test_it_is_trained_evaluated_and_rendered(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(evaluation, "usable_cpus", lambda: 1)
    run, result, video = tmp_path / "run", tmp_path / "eval.json", tmp_path / "a.mp4"
    size = "--num-envs 4 --eval-every 64 --eval-episodes 1 --agent.rollout-length 8"
    options = f"--task press:Press --algo ppo --steps 64 {size}"
    start("train", *options.split(), "--out", run)
    assert load_policy(run).card.task == "press:Press"
    start("evaluate", run, "--episodes", 1, "--json", result)
    assert json.loads(result.read_text())["milestones"].keys() == {"near", "press"}
    if gl.find_backend():
        start("render", run, "--episodes", 1, "--steps", 2, "--out", video)
        assert video.stat().st_size > 1000


def start(program: str, *arguments: object) -> None:
    assert cli.run(main._program(program), list(map(str, arguments))) == 0


def test_an_entry_point_gives_it_a_name(tmp_path: Path, monkeypatch) -> None:
    project = tomllib.loads((FOLDER / "pyproject.toml").read_text())["project"]
    points = project["entry-points"]["manip.tasks"]
    info = tmp_path / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir()
    lines = [f"{name} = {where}" for name, where in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[manip.tasks]", *lines]))
    assert "Press" not in task_names()
    monkeypatch.syspath_prepend(tmp_path)
    assert "Press" in task_names()
    assert load_task("Press").name == "Press"


@pytest.mark.slow
def test_pip_installs_it(tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in FOLDER.iterdir():
        (copy / path.name).write_text(path.read_text())
    target = ["--no-build-isolation", "--target", str(tmp_path / "site"), str(copy)]
    subprocess.run([*pip, *target], check=True)
    listed = subprocess.run(
        [sys.executable, "-m", "manip.programs.main", "list", "--json"],
        env={"PYTHONPATH": str(tmp_path / "site")},
        capture_output=True,
        check=True,
    )
    assert "Press" in json.loads(listed.stdout)["tasks"]


# Mistakes


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
    message = f"task 'Mine': ArithmeticError: so sad (test_own_task.py, line {line})"
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


def parts_of(m: Any) -> dict[str, Any]:
    return {"to_button": m["to_button"], "depth": m["depth"][:, None]}


CHANGES: dict[str, tuple[str, Method]] = {
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
