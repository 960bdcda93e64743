"""The checks of `manip doctor`.

Simulators and torch are tried in child processes: a broken one cannot break this
program, and nothing heavy is imported to print a table.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from manip.cpus import usable_cpus
from manip.sim.gl import INSTALL_HINT, find_backend

TESTED = {
    "mujoco": "3.8.1",
    "dm-control": "1.0.41",
    "robosuite": "1.5.2",
    "torch": "2.13.0",
    "torchrl": "0.14.1",
    "tensordict": "0.14.3",
    "numba": "0.68.1",
}
"""Versions that work together: a dm-control reads the structures of one mujoco only,
and robosuite 1.5.2 fails from mujoco 3.10 on."""

_NEEDED_DISK = 2 * 2**30
"""Bytes; a run with a full replay buffer and the compiled code need less."""

_CHILD_SECONDS = 120
_PACKAGE_ROOT = Path(__file__).parents[2]

CACHE_REMEDY = (
    "set NUMBA_CACHE_DIR to a writable folder; without one, code is compiled at each "
    "start"
)

_REMEDIES = {
    "cannot cache function": CACHE_REMEDY,
    "no locator available": CACHE_REMEDY,
    "NUMBA_": "unset or correct the environment variable",
    "MUJOCO_GL": "unset or correct the environment variable",
    "Permission denied": "make it writable, or set HOME to a writable folder",
    "Read-only file system": "make it writable, or set HOME to a writable folder",
    "No space left": "free disk space",
    "Cannot allocate memory": "free memory",
}
"""Text in the last line of a child -> what to do; the first that fits counts."""

_DM_CONTROL = """
from dm_control import suite
suite.load("cartpole", "swingup").reset()
print("cartpole swingup runs")
"""
_ROBOSUITE = """
from manip.sim.robosuite_factory import make_stock
make_stock("Lift").reset()
print("Lift with a Panda runs")
"""
_TORCH = """
import torch, torchrl.envs, torchrl.objectives
print(f"torch computes with {torch.get_num_threads()} threads")
"""
_CUDA = """
import torch
built = torch.version.cuda
if built and not torch.cuda.is_available():
    raise RuntimeError(f"built for CUDA {built}, finds no GPU")
print(f"built for CUDA {built}" if built else "built for the CPU")
"""
_NUMBA_CACHE = """
from manip.compiled import cache_folder, cache_is_writable
print(cache_folder())
if not cache_is_writable():
    raise RuntimeError(f"{cache_folder()} is not writable")
"""


@dataclass(frozen=True)
class Check:
    """Result of a check; `remedy` is advice for a failed check."""

    name: str
    ok: bool
    required: bool
    detail: str
    remedy: str


def check_python() -> Check:
    """Python is new enough for the package."""
    return Check(
        "Python",
        ok=sys.version_info >= (3, 11),
        required=True,
        detail=sys.version.split()[0],
        remedy="install Python 3.11 or newer",
    )


def check_package(name: str) -> Check:
    """The package is installed; another version than the tested one is reported."""
    tested = TESTED[name]
    try:
        installed = version(name)
    except PackageNotFoundError:
        installed = ""
    same = installed.split("+")[0] == tested
    detail = installed if same else f"{installed or 'missing'} (tested with {tested})"
    return Check(name, bool(installed), True, detail, f"pip install {name}=={tested}")


def check_dm_control() -> Check:
    """dm_control and mujoco fit: a task loads, which an import does not show."""
    ok, detail = _try(_DM_CONTROL)
    remedy = remedy_of(detail, _pins("mujoco", "dm-control"))
    return Check("dm_control on mujoco", ok, True, detail, remedy)


def check_robosuite() -> Check:
    """robosuite and mujoco fit: an environment can be built and reset."""
    ok, detail = _try(_ROBOSUITE)
    remedy = remedy_of(detail, _pins("mujoco", "robosuite"))
    return Check("robosuite on mujoco", ok, True, detail, remedy)


def check_torch() -> Check:
    """torch and torchrl can be imported together."""
    ok, detail = _try(_TORCH)
    remedy = remedy_of(detail, _pins("torch", "torchrl", "tensordict"))
    return Check("torchrl on torch", ok, True, detail, remedy)


def check_cuda() -> Check:
    """torch is not built for a missing GPU; only `--engine warp` uses one."""
    ok, detail = _try(_CUDA)
    remedy = (
        "everything works, on the CPU; torch's build for the CPU needs gigabytes less "
        "disk and starts faster"
    )
    return Check("torch's build", ok, False, detail, remedy)


def check_rendering() -> Check:
    """An OpenGL backend works, and MUJOCO_GL is not set to one that fails."""
    requested, working = os.environ.get("MUJOCO_GL", ""), find_backend()
    if working is None:
        detail = "no backend works: with MUJOCO_GL unset training works, videos do not"
        return Check("rendering", False, True, detail, INSTALL_HINT)
    if requested.strip().lower() not in ("", working):
        detail = f"MUJOCO_GL={requested} does not work, {working} does"
        return Check("rendering", False, True, detail, f"export MUJOCO_GL={working}")
    return Check("rendering", True, True, f"MUJOCO_GL={working} works", "")


def check_cpus() -> Check:
    """This process may use more than one core."""
    usable, present = usable_cpus(), os.cpu_count() or 1
    detail = f"{usable} of {present} cores usable"
    remedy = "everything works on one core, at half the speed of two"
    return Check("CPU", usable > 1, False, detail, remedy)


def check_numba_cache() -> Check:
    """Compiled code can be stored for later processes."""
    ok, detail = _try(_NUMBA_CACHE)
    return Check("numba cache", ok, False, detail, CACHE_REMEDY)


def check_disk() -> Check:
    """There is enough disk space for a run in the working directory."""
    free = shutil.disk_usage(Path.cwd()).free
    return Check(
        "disk",
        ok=free >= _NEEDED_DISK,
        required=False,
        detail=f"{free / 2**30:.1f} GiB free in {Path.cwd()}",
        remedy=(
            f"free {_NEEDED_DISK / 2**30:.0f} GiB, name another disk with --out, or "
            "leave replay buffers out of checkpoints with --no-save-buffer"
        ),
    )


CHECKS: tuple[Callable[[], Check], ...] = (
    check_python,
    *(partial(check_package, name) for name in TESTED),
    check_dm_control,
    check_robosuite,
    check_torch,
    check_cuda,
    check_rendering,
    check_cpus,
    check_disk,
    check_numba_cache,
)


def _try(code: str) -> tuple[bool, str]:
    """Run Python code in a child; return whether it worked, and its last line."""
    command = [sys.executable, "-c", code]
    # With a wrong MUJOCO_GL `import mujoco` itself fails; another check reports it.
    environment = os.environ | {"MUJOCO_GL": "disable"}
    try:
        child = subprocess.run(
            command,
            cwd=_PACKAGE_ROOT,
            env=environment,
            capture_output=True,
            text=True,
            timeout=_CHILD_SECONDS,
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer within {_CHILD_SECONDS} s"
    ok = child.returncode == 0
    output = child.stdout if ok else child.stderr
    lines = output.strip().splitlines() or [f"exit status {child.returncode}"]
    return ok, lines[-1]


def remedy_of(detail: str, otherwise: str) -> str:
    """What to do about a child's last line; `otherwise` if it has no known cause."""
    causes = (cause for cause in _REMEDIES if cause.lower() in detail.lower())
    return next((_REMEDIES[cause] for cause in causes), otherwise)


def _pins(*names: str) -> str:
    return "pip install " + " ".join(f"{name}=={TESTED[name]}" for name in names)
