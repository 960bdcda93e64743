"""Tasks and compiled scenes, each built once, because robosuite takes 0.5 to 2 s."""

import gc
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import torch
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

from manip import plugins
from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.robot_config import RobotConfig
from manip.sim.robosuite_factory import make_stock
from manip.sim.scene import Fidelity, Scene, build_scene

if TYPE_CHECKING:
    from playwright.sync_api import Browser

torch.set_num_threads(1)

SceneOf = Callable[..., Scene]


SHARED = (
    *("test_parity", "test_task_rewards", "test_task_starts"),
    *("test_tasks", "test_tastes", "test_visible_measures"),
)
"""Files that use the scenes of all tasks: one process builds them once."""


class OneProcess(LoadScopeScheduling):
    """Run the tests of a file, or of the files in SHARED, in one process.

    (The groups of pytest-xdist 3.8 have no effect with pytest 9.2.)
    """

    def _split_scope(self, nodeid: str) -> str:
        name = Path(nodeid.split("::")[0]).stem
        return "scenes" if name in SHARED else name


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> OneProcess:
    return OneProcess(config, log)


SAFE_PATH = os.environ.get("PYTHONSAFEPATH")
"""As the tests were started: programs set it."""


@pytest.fixture(autouse=True)
def _trust_again() -> Iterator[None]:
    """Forget after each test which folders its files made untrusted."""
    path = list(sys.path)
    _restore_safe_path()  # a fixture of a module may have run a program
    yield
    sys.path[:] = path
    plugins._untrusted.clear()
    _restore_safe_path()


@pytest.fixture(autouse=True, scope="module")
def _free_models() -> Iterator[None]:
    """Free a file's robosuite models, reference cycles of 300 MB, after it."""
    yield
    gc.collect()


def _restore_safe_path() -> None:
    if not SAFE_PATH:
        os.environ.pop("PYTHONSAFEPATH", None)


@pytest.fixture(scope="session")
def scene_of() -> SceneOf:
    """A function that gives the exact or fast scene of a task on a Panda.

    Scenes share the stock environment `scene.stock`. Reset it before use: other tests
    leave it in any state.
    """
    stocks, scenes = {}, {}

    def scene_of(
        task: Task, controller: str = "OSC_POSE", fidelity: Fidelity = "exact"
    ) -> Scene:
        stock_key = task.robosuite_name, controller
        key = type(task), *stock_key, fidelity
        if stock_key not in stocks:
            robot = RobotConfig(controller=controller)
            stocks[stock_key] = make_stock(task.robosuite_name, robot, seed=3)
        if key not in scenes:
            scenes[key] = build_scene(
                stocks[stock_key], task.sensors, control_freq=20, fidelity=fidelity
            )
        return scenes[key]

    return scene_of


@pytest.fixture(scope="session")
def door() -> Task:
    return load_task("Door")


@pytest.fixture(scope="session")
def lift() -> Task:
    return load_task("Lift")


@pytest.fixture(scope="session")
def reach() -> Task:
    return load_task("Reach")


@pytest.fixture(scope="session")
def door_scene(scene_of: SceneOf, door: Task) -> Scene:
    return scene_of(door)


@pytest.fixture(scope="session")
def lift_scene(scene_of: SceneOf, lift: Task) -> Scene:
    return scene_of(lift)


@pytest.fixture(scope="session")
def reach_scene(scene_of: SceneOf, reach: Task) -> Scene:
    return scene_of(reach)


CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "chrome")
ARGUMENTS = (
    *("--no-sandbox", "--disable-background-networking"),
    "--enable-unsafe-swiftshader",  # WebGL without a GPU
)


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """The machine's Chromium, without a window."""
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if path is None:
        pytest.fail(
            f"no browser: none of {', '.join(CHROMIUM)} is installed "
            "(Debian: `apt-get install chromium`)"
        )
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*ARGUMENTS])
        yield browser
        browser.close()
