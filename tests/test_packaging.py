"""The distribution: its only top-level package is `manip`, with tasks and assets."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
from pathlib import Path
from zipfile import ZipFile

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
SOURCES = ("manip", "tasks", "assets", "pyproject.toml", "README.md", "LICENSE")
PACKAGED = (".py", ".json", ".safetensors", ".xml", ".yaml")


def build(folder: Path, kind: str, into: Path) -> Path:
    """Build a "wheel", "sdist" or "editable" from the sources in `folder`."""
    call = f"from setuptools import build_meta as b; b.build_{kind}({str(into)!r})"
    subprocess.run([sys.executable, "-c", call], cwd=folder, check=True)
    (file,) = into.iterdir()
    return file


@pytest.fixture(scope="module")
def checkout(tmp_path_factory) -> Path:
    """A copy of what the distribution is built from, links kept."""
    folder = tmp_path_factory.mktemp("checkout")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            ignore = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, folder / name, symlinks=True, ignore=ignore)
        else:
            shutil.copy(ROOT / name, folder)
    return folder


@pytest.fixture(scope="module")
def wheel(checkout: Path, tmp_path_factory) -> Path:
    return build(checkout, "wheel", tmp_path_factory.mktemp("wheel"))


def contents(wheel: Path) -> set[str]:
    return set(ZipFile(wheel).namelist())


def packaged(folder: str) -> set[str]:
    files = (ROOT / folder).rglob("*")
    return {
        file.relative_to(ROOT).as_posix() for file in files if file.suffix in PACKAGED
    }


def test_the_wheel_holds_manip_alone(wheel: Path) -> None:
    roots = {name.split("/")[0] for name in contents(wheel)}
    assert {root for root in roots if not root.endswith(".dist-info")} == {"manip"}
    assert wheel.name.startswith("manip_suite-")


@pytest.mark.parametrize("folder", ["tasks", "assets"])
def test_the_wheel_holds_all_tasks_and_assets(wheel: Path, folder: str) -> None:
    expected = {f"manip/{name}" for name in packaged(folder)}
    assert len(expected) > 20
    inside = {name for name in contents(wheel) if name.startswith(f"manip/{folder}/")}
    assert inside == expected


def test_the_sdist_builds_the_same_wheel(
    checkout: Path, wheel: Path, tmp_path: Path
) -> None:
    for name in "sdist", "wheel", "unpacked":
        (tmp_path / name).mkdir()
    sdist = build(checkout, "sdist", tmp_path / "sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (folder,) = (tmp_path / "unpacked").iterdir()
    assert contents(build(folder, "wheel", tmp_path / "wheel")) == contents(wheel)


@pytest.fixture(scope="module", params=["wheel", "editable"])
def installed(request, checkout: Path, tmp_path_factory) -> Path:
    """A site directory with manip installed."""
    folder = tmp_path_factory.mktemp(request.param)
    ZipFile(build(checkout, request.param, folder)).extractall(folder)
    return folder


IMPORTS = """
import site, sys
site.addsitedir(sys.argv[1])
import manip.envs.adapters.gymnasium
from manip.agents.policy import SHIPPED
from manip.envs.task_registry import load_task, task_names
assert len(task_names()) > 10
assert all(load_task(name).name == name for name in task_names())
assert load_task("tasks.press:Press").horizon
assert (SHIPPED / "Lift").is_dir()
import assets, tasks
assert assets.USERS and tasks.USERS
print(manip.__file__)
"""


def test_it_does_not_hide_a_users_own_packages(
    installed: Path, checkout: Path, tmp_path: Path
) -> None:
    """A user's folder is searched last, as by the `manip` command (python -P)."""
    for name in "tasks", "assets":
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("USERS = True\n")
    shutil.copy(ROOT / "docs/own_task/press.py", tmp_path / "tasks")
    result = subprocess.run(
        [sys.executable, "-P", "-S", "-c", IMPORTS, str(installed)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": sysconfig.get_path("purelib")},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    place = Path(result.stdout.strip())
    assert place.is_relative_to(installed) or place.is_relative_to(checkout)
