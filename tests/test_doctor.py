"""The doctor's checks, its report and its exit code."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from manip.programs import doctor, doctor_checks
from manip.programs.doctor import Doctor, run
from manip.programs.doctor_checks import Check

GOOD = Check("good", ok=True, required=True, detail="[here]", remedy="none")
SLOWER = Check("slower", ok=False, required=False, detail="one core", remedy="wait")
BROKEN = Check("broken", ok=False, required=True, detail="lost", remedy="install it")


@pytest.fixture
def use_checks(monkeypatch: pytest.MonkeyPatch):
    def use(*checks: Check) -> None:
        stubs = tuple((lambda check=check: check) for check in checks)
        monkeypatch.setattr(doctor, "CHECKS", stubs)

    return use


def test_fit_needs_every_required_check_and_no_other(use_checks) -> None:
    use_checks(GOOD, SLOWER)
    assert run(Doctor()) == 0
    use_checks(GOOD, BROKEN)
    assert run(Doctor()) == 1


def test_report_gives_findings_and_the_remedies_needed(use_checks, capsys) -> None:
    use_checks(GOOD, SLOWER, BROKEN)
    run(Doctor())
    report = capsys.readouterr().out
    for text in ("[here]", "slower: wait", "broken: install it", "not fit"):
        assert text in report
    assert "good: none" not in report


def test_json_holds_every_check(use_checks, capsys) -> None:
    use_checks(GOOD, BROKEN)
    run(Doctor(json=True))
    report = json.loads(capsys.readouterr().out)
    assert report["fit"] is False
    assert [check["name"] for check in report["checks"]] == ["good", "broken"]
    assert report["checks"][1]["remedy"] == "install it"


def test_python_and_cores_are_found() -> None:
    assert doctor_checks.check_python().ok
    assert doctor_checks.usable_cpus() >= 1
    assert "usable" in doctor_checks.check_cpus().detail


def test_a_missing_package_is_named_with_its_tested_version(monkeypatch) -> None:
    monkeypatch.setitem(doctor_checks.TESTED, "no-such-package", "1.2.3")
    check = doctor_checks.check_package("no-such-package")
    assert not check.ok
    assert check.detail == "missing (tested with 1.2.3)"
    assert check.remedy == "pip install no-such-package==1.2.3"


def test_another_version_is_mentioned_but_passes(monkeypatch) -> None:
    monkeypatch.setattr(doctor_checks, "version", lambda name: "9.9.9")
    check = doctor_checks.check_package("mujoco")
    assert check.ok
    assert check.detail.startswith("9.9.9 (tested with ")


def test_a_failing_child_gives_its_last_line() -> None:
    assert doctor_checks._try("print('a'); print('b')") == (True, "b")
    assert doctor_checks._try("raise OSError('gone')") == (False, "OSError: gone")


@pytest.mark.parametrize(
    ("working", "requested", "ok"),
    [
        ("egl", "", True),
        ("egl", "EGL", True),
        ("egl", "osmesa", False),
        (None, "", False),
    ],
)
def test_rendering_needs_a_backend_that_is_not_contradicted(
    working, requested, ok, monkeypatch
) -> None:
    monkeypatch.setattr(doctor_checks, "find_backend", lambda: working)
    monkeypatch.setenv("MUJOCO_GL", requested)
    check = doctor_checks.check_rendering()
    assert check.ok is ok
    assert bool(check.remedy) is not ok


def test_dm_control_loads_a_task_on_this_mujoco() -> None:
    check = doctor_checks.check_dm_control()
    assert check.ok, check.detail


def put_before(monkeypatch, folder: Path, name: str, source: str) -> None:
    """Have children of the doctor import another module of this name."""
    (folder / f"{name}.py").write_text(source)
    monkeypatch.setenv("PYTHONPATH", str(folder))


@pytest.mark.parametrize(
    ("check", "pins"),
    [
        (doctor_checks.check_dm_control, "mujoco==3.8.1 dm-control==1.0.41"),
        (doctor_checks.check_robosuite, "mujoco==3.8.1 robosuite==1.5.2"),
    ],
)
def test_a_mujoco_that_does_not_fit_is_found(check, pins, monkeypatch, tmp_path):
    put_before(monkeypatch, tmp_path, "mujoco", "__version__ = '2.3.7'")
    result = check()
    assert not result.ok
    assert result.required
    assert "mujoco" in result.detail
    assert result.remedy == f"pip install {pins}"


@pytest.mark.parametrize(
    ("cuda", "gpu", "ok", "detail"),
    [
        ("12.8", False, False, "built for CUDA 12.8, finds no GPU"),
        ("12.8", True, True, "built for CUDA 12.8"),
        (None, False, True, "built for the CPU"),
    ],
)
def test_a_torch_for_a_gpu_that_is_not_there_is_found(
    cuda, gpu, ok, detail, monkeypatch, tmp_path
) -> None:
    source = f"""
class version: cuda = {cuda!r}
class cuda: is_available = lambda: {gpu}
"""
    put_before(monkeypatch, tmp_path, "torch", source)
    check = doctor_checks.check_cuda()
    assert (check.ok, check.required) == (ok, False)
    assert check.detail.endswith(detail)
    assert "on the CPU" in check.remedy


@pytest.mark.parametrize(("cores", "ok"), [(1, False), (2, True)])
def test_a_single_core_is_mentioned(cores: int, ok: bool, monkeypatch) -> None:
    monkeypatch.setattr(doctor_checks, "usable_cpus", lambda: cores)
    check = doctor_checks.check_cpus()
    assert (check.ok, check.required) == (ok, False)
    assert check.detail.startswith(f"{cores} of ")


@pytest.mark.parametrize(("free", "ok"), [(0.3, False), (2.0, True)])
def test_a_disk_that_is_nearly_full_is_found(free, ok, monkeypatch) -> None:
    usage = SimpleNamespace(free=free * 2**30)
    monkeypatch.setattr(doctor_checks.shutil, "disk_usage", lambda path: usage)
    check = doctor_checks.check_disk()
    assert (check.ok, check.required) == (ok, False)
    assert check.detail == f"{free} GiB free in {Path.cwd()}"
    assert "--out" in check.remedy


def test_a_cache_that_cannot_be_written_is_found(monkeypatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc/no-such-folder")
    check = doctor_checks.check_numba_cache()
    assert (check.ok, check.required) == (False, False)
    assert "/proc/no-such-folder" in check.detail
    assert "NUMBA_CACHE_DIR" in check.remedy


@pytest.mark.slow
def test_this_machine_is_fit() -> None:
    assert run(Doctor()) == 0


@pytest.mark.parametrize(
    ("detail", "remedy"),
    [
        (
            "RuntimeError: cannot cache function 'mat2quat': no locator available",
            doctor_checks.CACHE_REMEDY,
        ),
        ("ValueError: NUMBA_NUM_THREADS must be positive", "environment variable"),
        ("PermissionError: [Errno 13] Permission denied: '/x'", "HOME"),
        ("AttributeError: mj_fullM", "pip install mujoco==3.8.1"),
    ],
)
def test_the_remedy_fits_the_cause(detail: str, remedy: str) -> None:
    assert remedy in doctor_checks.remedy_of(detail, "pip install mujoco==3.8.1")


def test_an_unwritable_home_is_not_mended_by_another_robosuite(monkeypatch, tmp_path):
    source = 'raise RuntimeError("cannot cache function: no locator available")'
    put_before(monkeypatch, tmp_path, "robosuite", source)
    check = doctor_checks.check_robosuite()
    assert (check.ok, check.remedy) == (False, doctor_checks.CACHE_REMEDY)


def test_checks_hold_without_assertions(monkeypatch) -> None:
    """`python -O` removes assert statements."""
    monkeypatch.setenv("PYTHONOPTIMIZE", "1")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc/no-such-folder")
    assert not doctor_checks.check_numba_cache().ok
