"""A task of one's own: the documented example works, mistakes are told in one line."""

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
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
    """As a user does: working where the module lies, without installing it."""
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
    theirs = StockBatch(press, stock=scene.stock)
    ours = NativeBatch(press, 2, scene=scene, threads=1)
    theirs.begin(np.arange(1))
    copy_start(press, ours.engine, range(2))
    for _ in range(25):
        action = press.expert(press.measure(theirs.read())).astype(np.float32)
        time_step, expected = ours.step(action.repeat(2, 0)), theirs.step(action)
        np.testing.assert_allclose(
            time_step.observation[:1], expected.observation, 0, 1e-4
        )
        np.testing.assert_allclose(time_step.reward[:1], expected.reward, 0, 1e-4)
        assert time_step.success[0] == expected.success == scene.stock._check_success()
    assert time_step.success.all()


def test_every_episode_can_be_solved(press: Task, scene: Scene) -> None:
    worlds = NativeBatch(press, 8, scene=scene)
    worlds.begin(np.arange(8))
    found = [worlds.step(worlds.expert()) for _ in range(40)]
    assert not found[0].success.any()
    assert np.all([time_step.success for time_step in found[-10:]])


def test_it_is_trained_judged_and_filmed(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(evaluation, "usable_cpus", lambda: 1)
    run, result, film = tmp_path / "run", tmp_path / "eval.json", tmp_path / "film.mp4"
    size = "--num-envs 4 --eval-every 64 --eval-episodes 1 --agent.rollout-length 8"
    rig = f"--task press:Press --algo ppo --steps 64 {size}"
    start("train", *rig.split(), "--out", run)
    assert load_policy(run).card.task == "press:Press"
    start("evaluate", run, "--episodes", 1, "--json", result)
    assert json.loads(result.read_text())["milestones"].keys() == {"near", "press"}
    if gl.find_backend():
        start("render", run, "--episodes", 1, "--steps", 2, "--out", film)
        assert film.stat().st_size > 1000


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
    "measure() gives NoneType, not named arrays": ("measure", lambda task, read: None),
    "measure(): unknown measure 'buton_pos': did you mean 'button_pos'? known": (
        "measure",
        lambda task, read: {**read, "place": read["buton_pos"]},
    ),
    "observe() part 'depth' has shape (3,), not (3, k): a row a world": (
        "observe",
        lambda task, m: {"depth": m["depth"]},
    ),
    "observe() part 'rest' has shape (1, 7), not (3, k): a row a world": (
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
    "observe() gives no numbers: nothing to act on": (
        "observe",
        lambda task, m: {},
    ),
    "reward_terms(m, 'shaped') gives 'near', but weights['shaped'] names 'near', ": (
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
    "update_memory() gives 'pushed', but sensors.memory names nothing": (
        "update_memory",
        lambda task, m: {"pushed": m["button_qpos"]},
    ),
    "milestones() gives 'near', 'push', but milestones names 'near', 'press'": (
        "milestones",
        lambda task, m: dict.fromkeys(["near", "push"], m["depth"] > 0),
    ),
    "milestones() stage 'near' holds float64, not bool": (
        "milestones",
        lambda task, m: dict.fromkeys(task.milestone_names, m["depth"]),
    ),
    "sample_start() gives ndarray, not Start(qpos, fields)": (
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
"""What is told -> the method that is wrong, and how."""


def at_rest(scene: Scene, episodes: int) -> np.ndarray:
    return np.tile(scene.layout.qpos, (episodes, 1))


@pytest.mark.parametrize("told", MISTAKES)
def test_a_wrong_part_is_told_when_its_worlds_are_built(
    told: str, press: Task, scene: Scene
) -> None:
    method, body = MISTAKES[told]
    wrong = type("Mine", (type(press),), {method: body})()
    with pytest.raises(UserError) as error:
        NativeBatch(wrong, 3, scene=scene, threads=1)
    assert str(error.value).startswith(f"task 'Mine': {told}")
    assert "\n" not in str(error.value)


def fails(task: Task, m: Any) -> Any:
    raise ArithmeticError("so\nsad")


@pytest.mark.parametrize("method", ["measure", "observe", "success", "update_memory"])
def test_an_error_inside_a_task_is_told_with_its_place(method, press, scene) -> None:
    wrong = type("Mine", (type(press),), {method: fails, "__module__": __name__})()
    line = fails.__code__.co_firstlineno + 1
    told = f"task 'Mine': ArithmeticError: so sad (test_own_task.py, line {line})"
    with pytest.raises(UserError) as error:
        NativeBatch(wrong, 3, scene=scene, threads=1)
    assert str(error.value) == told


def test_an_error_in_a_later_step_is_told(press: Task, scene: Scene) -> None:
    wrong = type("Mine", (type(press),), {})()
    worlds = NativeBatch(wrong, 3, scene=scene, threads=1)
    worlds.begin(np.arange(3))
    wrong.observe = lambda m: {"depth": m["depth"]}
    with pytest.raises(UserError, match="task 'Mine': "):
        worlds.step(np.zeros((3, 7)))


PARTS = ("measure", "observe", "reward_terms", "success", "failure", "update_memory")
PARTS += (
    "milestones",
    "sample_start",
    "horizon",
    "weights",
    "milestone_names",
    "sensors",
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
    """What is seen of three worlds at first and after a step, or what is told."""
    try:
        worlds = NativeBatch(task, 3, scene=scene, threads=1)
        worlds.begin(np.arange(3))
        return [worlds.observe(), worlds.step(np.zeros((3, 7)))]
    except UserError as error:
        return str(error)


def assert_right_or_told(part: str, value: Any, press: Task, scene: Scene) -> None:
    data = part in ("horizon", "weights", "milestones", "sensors")
    body = value if data else lambda task, *given: value
    moments = played(type("Odd", (type(press),), {part: body})(), scene)
    if isinstance(moments, str):
        assert "\n" not in moments
        return
    for time_step in moments:
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
def test_whatever_a_task_gives_is_right_or_told_in_a_line(
    part: str, value: Any, press: Task, scene: Scene
) -> None:
    assert_right_or_told(part, value, press, scene)


@pytest.mark.slow
@settings(patient, max_examples=2000)
@given(part=st.sampled_from(PARTS), value=given_back)
def test_thousands_of_odd_parts_are_right_or_told(
    part: str, value: Any, press: Task, scene: Scene
) -> None:
    assert_right_or_told(part, value, press, scene)


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("class Odd(", "SyntaxError: '(' was never closed (odd.py, line 1)"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
    ],
)
def test_a_module_that_cannot_be_imported_is_told(
    source: str, told: str, tmp_path: Path, monkeypatch
) -> None:
    (tmp_path / "odd.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UserError) as error:
        load_task("odd:Odd")
    assert str(error.value) == f"cannot import task 'odd:Odd': {told}"


def test_a_task_without_its_numbers_is_told(press: Task, monkeypatch) -> None:
    bare = type("Bare", (Task,), {"name": "bare", "milestones": ("near",)})
    monkeypatch.setattr(sys.modules["press"], "Bare", bare, raising=False)
    missing = "measure, observe, .*, success, robosuite_name, sensors, horizon, weights, milestone_names$"
    with pytest.raises(UserError, match=f"'press:Bare' does not define {missing}"):
        load_task("press:Bare")
