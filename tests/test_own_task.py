"""A user's own task: the documented example works, mistakes give one-line errors."""

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from twin import copy_start

from manip.agents.policy import load_policy
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.task import Task
from manip.envs.task_registry import load_task, task_names
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
