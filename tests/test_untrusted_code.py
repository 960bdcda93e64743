"""Classes named by a file: code that came along with the file is never run."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

EVIL = """
from pathlib import Path
Path({marker!r}).write_text("ran")
class Task: pass
"""

NAMED_BY_A_FILE = """
import sys
from pathlib import Path
from manip.errors import UserError
from manip.plugins import check_origin, load_class
name, folder = sys.argv[1:]
try:
    check_origin(name, "manip.tasks", "task", Path(folder))
    print("loaded", load_class(name, "manip.tasks", "task").__module__)
except UserError as error:
    print(error)
    sys.exit(2)
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A user's folder with a run that brings code, and the user's own module."""
    (tmp_path / "runs/demo/policy").mkdir(parents=True)
    (tmp_path / "runs/demo/config.yaml").write_text("task: x")
    (tmp_path / "own.py").write_text("class Task: pass")
    evil = EVIL.format(marker=str(tmp_path / "marker"))
    (tmp_path / "runs/demo/evil.py").write_text(evil)
    (tmp_path / "runs/demo/policy/evil.py").write_text(evil)
    return tmp_path


def load(name: str, folder: str, cwd: Path, *path: Path) -> subprocess.CompletedProcess:
    """Load a class that a file in `folder` names, in another process."""
    return subprocess.run(
        [sys.executable, "-P", "-c", NAMED_BY_A_FILE, name, folder],
        cwd=cwd,
        env={"PYTHONPATH": ":".join(map(str, (ROOT, *path)))},
        capture_output=True,
        text=True,
        check=False,
    )


def assert_refused(result: subprocess.CompletedProcess, project: Path) -> None:
    assert result.returncode == 2, result.stdout + result.stderr
    assert not (project / "marker").exists()


def test_a_module_of_the_users_own_is_loaded(project: Path) -> None:
    result = load("own:Task", "runs/demo", project)
    assert result.stdout == "loaded own\n", result.stdout + result.stderr


@pytest.mark.parametrize(
    "folder", ["runs/demo", "runs/demo/policy", "./runs/../runs/demo"]
)
@pytest.mark.parametrize(
    "name",
    ["runs.demo.evil:Task", "runs.demo.policy.evil:Task", "runs.demo.evil.x:Task"],
)
def test_a_module_in_a_namespace_package_over_the_run_is_refused(
    name: str, folder: str, project: Path
) -> None:
    result = load(name, folder, project)
    assert_refused(result, project)
    assert "which came along with" in result.stdout


@pytest.mark.parametrize("package", ["runs", "runs/demo", "runs/demo/policy"])
def test_a_package_on_the_way_is_not_run(package: str, project: Path) -> None:
    marker = str(project / "marker")
    (project / package / "__init__.py").write_text(EVIL.format(marker=marker))
    result = load("runs.demo.policy.evil:Task", "runs/demo", project)
    assert_refused(result, project)


def test_a_policy_folder_alone_counts_with_what_lies_beside_it(project: Path) -> None:
    (project / "runs/demo/config.yaml").unlink()
    result = load("runs.demo.evil:Task", "runs/demo/policy", project)
    assert_refused(result, project)


def test_a_module_that_is_linked_out_of_the_run_is_refused(project: Path) -> None:
    (project / "linked.py").symlink_to(project / "runs/demo/evil.py")
    assert_refused(load("linked:Task", "runs/demo", project), project)
    (project / "package").symlink_to(project / "runs/demo", target_is_directory=True)
    assert_refused(load("package.evil:Task", "runs/demo", project), project)


def test_a_module_that_is_linked_into_the_run_is_refused(project: Path) -> None:
    (project / "runs/demo/good.py").symlink_to(project / "own.py")
    assert_refused(load("runs.demo.good:Task", "runs/demo", project), project)


def test_a_run_that_is_a_link_counts_with_its_target(project: Path) -> None:
    (project / "shortcut").symlink_to(project / "runs/demo", target_is_directory=True)
    assert_refused(load("runs.demo.evil:Task", "shortcut", project), project)
    assert_refused(load("shortcut.evil:Task", "runs/demo", project), project)


def test_a_policy_that_is_a_link_counts_with_its_folder(project: Path) -> None:
    real = project / "runs/demo/policy/policy.safetensors"
    real.write_text("")
    (project / "copy").mkdir()
    (project / "copy/policy.safetensors").symlink_to(real)
    assert_refused(load("runs.demo.evil:Task", "copy", project), project)


@pytest.mark.parametrize("folder", [".", "policy", "..", "checkpoints"])
def test_in_the_run_only_installed_code_is_found(folder: str, project: Path) -> None:
    run = project / "runs/demo"
    if folder == "..":
        run, folder = run / "policy", ".."
    result = load("evil:Task", folder, run)
    assert_refused(result, project)
    assert_refused(load("own:Task", folder, run, run), project)


def entry_point(folder: Path, name: str, where: str) -> None:
    info = folder / "evil-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: evil\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[manip.tasks]\n{name} = {where}\n")


@pytest.mark.parametrize("name", ["Evil", "Lift"])
@pytest.mark.parametrize("inside", [True, False])
def test_entry_points_of_the_run_are_not_read(
    name: str, inside: bool, project: Path
) -> None:
    """Nor those of the working directory, which only is searched for modules."""
    run = project / "runs/demo"
    entry_point(run if inside else project, name, "evil:Task")
    (project / "evil.py").write_text((run / "evil.py").read_text())
    result = load(name, "." if inside else "runs/demo", run if inside else project)
    assert not (project / "marker").exists()
    expected = "unknown task 'Evil'" if name == "Evil" else "loaded manip.tasks.lift"
    assert expected in result.stdout, result.stdout + result.stderr


def test_an_installed_entry_point_into_the_run_is_refused(project: Path) -> None:
    site = project / "site"
    site.mkdir()
    entry_point(site, "Evil", "runs.demo.evil:Task")
    assert_refused(load("Evil", "runs/demo", project, site), project)


def test_a_run_on_the_search_path_is_taken_off_it(project: Path) -> None:
    assert_refused(
        load("evil:Task", "runs/demo", project, project / "runs/demo"), project
    )


def test_workers_that_start_in_the_run_import_nothing_from_it(project: Path) -> None:
    """Workers start as `python -c`, which searches the working directory."""
    run = project / "runs/demo"
    for module in ("multiprocessing", "random", "struct", "pickle", "evil"):
        (run / f"{module}.py").write_text(EVIL.format(marker=str(project / "marker")))
    code = """
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from manip.plugins import check_origin
if __name__ == "__main__":
    check_origin("Lift", "manip.tasks", "task", Path("."))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context) as pool:
        assert pool.submit(len, "abc").result() == 3
"""
    (project / "program.py").write_text(code)
    command = [sys.executable, str(project / "program.py")]
    environment = {"PYTHONPATH": str(ROOT)}
    subprocess.run(command, cwd=run, env=environment, check=True)
    assert not (project / "marker").exists()


def test_children_of_a_program_import_nothing_from_the_working_directory(
    project: Path,
) -> None:
    """mujoco imports glfw, which looks for its library in children."""
    run = project / "runs/demo"
    for module in ("ctypes", "glob", "json", "numpy", "os", "re", "torch"):
        (run / f"{module}.py").write_text(EVIL.format(marker=str(project / "marker")))
    main = "from manip.programs.main import main; main()"
    result = subprocess.run(
        [sys.executable, "-P", "-c", main, "evaluate", "."],
        cwd=run,
        env={"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert_refused(result, project)
    assert "holds no policy" in result.stderr


def test_installed_tasks_are_found_where_the_environment_lies_in_the_folder() -> None:
    """`manip evaluate .` in a project that holds its virtual environment."""
    result = load("Lift", str(Path(sys.prefix).parent), ROOT)
    assert result.stdout == "loaded manip.tasks.lift\n", result.stdout + result.stderr
