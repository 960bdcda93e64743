"""Compiled code on disk, and where it cannot be stored or compiled."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import manip.compiled
import manip.errors

HELPER = """
from manip.compiled import kernel
@kernel
def answer():
    return {}
"""
CALLER = """
from manip.compiled import jit
from manip.helper import answer
@jit
def call():
    return answer()
print(call(), sum(call.stats.cache_hits.values()))
"""


def call(folder: Path, answer: int) -> list[int]:
    """The caller's result in a new process, and its number of cache hits."""
    package = folder / "manip"
    package.mkdir(exist_ok=True)
    files = {"__init__": "", "helper": HELPER.format(answer), "caller": CALLER}
    for module in (manip.compiled, manip.errors):
        files[module.__name__.split(".")[1]] = Path(module.__file__).read_text()
    for name, text in files.items():
        path = package / f"{name}.py"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
    command = [sys.executable, "-m", "manip.caller"]
    done = subprocess.run(
        command, cwd=folder, env=clean(), capture_output=True, text=True, check=True
    )
    return [int(word) for word in done.stdout.split()]


def clean(**variables: str) -> dict[str, str]:
    """The environment without the paths that would find the real package first."""
    inherited = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    return inherited | variables


def test_a_change_of_a_called_function_is_compiled(tmp_path) -> None:
    assert call(tmp_path, 1) == [1, 0]
    assert call(tmp_path, 1) == [1, 1]
    assert call(tmp_path, 22) == [22, 0]


def in_python(code: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=False,
    )


COMPILE = """
import warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    from manip import compiled
print(*(str(w.message) for w in caught))
print(compiled.jit(lambda x: x + 1)(1))
"""


def test_a_cache_that_cannot_be_written_is_a_warning() -> None:
    done = in_python(COMPILE, NUMBA_CACHE_DIR=f"{os.devnull}/cache")
    warning, result = done.stdout.splitlines()
    assert f"{os.devnull}/cache/" in warning
    assert "is not writable" in warning
    assert "NUMBA_CACHE_DIR" in warning
    assert result == "2"


NOWHERE = {  # an install and a home that cannot be written
    "HOME": f"{os.devnull}/home",
    "NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator",
    "NUMBA_CACHE_DIR": "",
}
IMPORT_ROBOSUITE = """
import numba
import manip.sim.robosuite_factory
from robosuite.utils.transform_utils import quat2mat
print(repr(numba.config.CACHE_DIR))
print(quat2mat._cache.cache_path)
"""


def test_robosuite_is_imported_where_nothing_can_be_cached() -> None:
    done = in_python(IMPORT_ROBOSUITE, **NOWHERE)
    assert done.returncode == 0, done.stderr
    assert "code that robosuite compiles is not cached" in done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr
    setting, folder = done.stdout.splitlines()
    assert setting == "''"  # as before
    assert "manip-numba-" in folder
    assert not Path(folder).exists()


@pytest.mark.parametrize(
    ("variables", "text"),
    [
        ({"NUMBA_NUM_THREADS": "0"}, "NUMBA_NUM_THREADS=0: Number of threads"),
        ({"NUMBA_NUM_THREADS": "-3"}, "NUMBA_NUM_THREADS=-3: Number of threads"),
        ({"NUMBA_DISABLE_JIT": "1"}, "NUMBA_DISABLE_JIT is set, .* unset it"),
    ],
)
def test_settings_that_stop_numba_are_one_line(variables: dict, text: str) -> None:
    code = """
from manip.errors import UserError
try:
    import manip.envs
except UserError as error:
    print(error)
"""
    done = in_python(code, **variables)
    assert len(done.stdout.splitlines()) == 1, done.stderr
    assert re.search(text, done.stdout)
