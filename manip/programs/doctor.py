"""Check whether this machine can train, evaluate and draw, and say what to mend.

Simulators and torch are tried in child processes: what is broken cannot break the
doctor, and nothing heavy is imported to print a table.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from manip.cpus import usable_cpus
from manip.programs import cli
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
"""Versions known to work together: dm-control reads the memory of one mujoco only,
and robosuite 1.5.2 breaks from mujoco 3.10 on."""

_NEEDED_DISK = 2 * 2**30
"""Bytes that a run with a full replay buffer and the compiled code stay below."""

_CHILD_SECONDS = 120
_PACKAGE_ROOT = Path(__file__).parents[2]

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
assert not built or torch.cuda.is_available(), f"built for CUDA {built}, finds no GPU"
print(f"built for CUDA {built}" if built else "built for the CPU")
"""
_NUMBA_CACHE = """
from manip.compiled import cache_folder, cache_is_writable
print(cache_folder())
assert cache_is_writable(), f"{cache_folder()} is not writable"
"""


@dataclass(frozen=True)
class Doctor:
    """Check that this machine can train, evaluate and draw."""

    json: bool = False
    """Print the checks as JSON."""


@dataclass(frozen=True)
class Check:
    """What was looked at, what was found, and, where it is not ok, what to do."""

    name: str
    ok: bool
    required: bool
    detail: str
    remedy: str


def main(arguments: Sequence[str]) -> int:
    """Check this machine; 0 only when it is fit."""
    return run(cli.parse(Doctor, arguments, "manip doctor"))


def run(options: Doctor) -> int:
    """Print the checks; return 0 if every required one passes, else 1."""
    checks = [check() for check in CHECKS]
    fit = all(check.ok for check in checks if check.required)
    if options.json:
        print(json.dumps({"fit": fit, "checks": [asdict(c) for c in checks]}, indent=2))
    else:
        _print_report(checks, fit)
    return 0 if fit else 1


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
    """The package is installed; a version other than the tested one is mentioned."""
    tested = TESTED[name]
    try:
        found = version(name)
    except PackageNotFoundError:
        found = ""
    same = found.split("+")[0] == tested
    detail = found if same else f"{found or 'missing'} (tested with {tested})"
    return Check(name, bool(found), True, detail, f"pip install {name}=={tested}")


def check_dm_control() -> Check:
    """dm_control and mujoco fit: importing proves nothing, loading a task does."""
    ok, detail = _try(_DM_CONTROL)
    return Check(
        "dm_control on mujoco", ok, True, detail, _pins("mujoco", "dm-control")
    )


def check_robosuite() -> Check:
    """robosuite and mujoco fit: an environment can be built and reset."""
    ok, detail = _try(_ROBOSUITE)
    return Check("robosuite on mujoco", ok, True, detail, _pins("mujoco", "robosuite"))


def check_torch() -> Check:
    """torch and torchrl can be imported together."""
    ok, detail = _try(_TORCH)
    pins = _pins("torch", "torchrl", "tensordict")
    return Check("torchrl on torch", ok, True, detail, pins)


def check_cuda() -> Check:
    """torch is not built for a GPU that is not there; manip computes on the CPU."""
    ok, detail = _try(_CUDA)
    remedy = (
        "all works, on the CPU as always; torch's build for the CPU takes gigabytes "
        "less disk and starts faster"
    )
    return Check("torch's build", ok, False, detail, remedy)


def check_rendering() -> Check:
    """An OpenGL backend draws, and MUJOCO_GL does not name one that does not."""
    asked, found = os.environ.get("MUJOCO_GL", ""), find_backend()
    if found is None:
        detail = "nothing draws: with MUJOCO_GL unset training works, videos do not"
        return Check("rendering", False, True, detail, INSTALL_HINT)
    if asked.strip().lower() not in ("", found):
        detail = f"MUJOCO_GL={asked} does not work, {found} does"
        return Check("rendering", False, True, detail, f"export MUJOCO_GL={found}")
    return Check("rendering", True, True, f"MUJOCO_GL={found} draws", "")


def check_cpus() -> Check:
    """How many cores this process may use."""
    usable, present = usable_cpus(), os.cpu_count() or 1
    detail = f"{usable} of {present} cores usable"
    remedy = "all works on one core, at half the speed of two"
    return Check("CPU", usable > 1, False, detail, remedy)


def check_numba_cache() -> Check:
    """Compiled code can be kept between processes."""
    ok, detail = _try(_NUMBA_CACHE)
    remedy = "set NUMBA_CACHE_DIR to a writable folder, or compile at each start"
    return Check("numba cache", ok, False, detail, remedy)


def check_disk() -> Check:
    """There is room for a run in the working directory."""
    free = shutil.disk_usage(Path.cwd()).free
    return Check(
        "disk",
        ok=free >= _NEEDED_DISK,
        required=False,
        detail=f"{free / 2**30:.1f} GiB free in {Path.cwd()}",
        remedy=(
            f"make room for {_NEEDED_DISK / 2**30:.0f} GiB, name another disk with "
            "--out, or leave replay buffers out of checkpoints with --no-save-buffer"
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
    """Run Python code in a child; return whether it worked and its last line."""
    command = [sys.executable, "-c", code]
    # With a broken MUJOCO_GL `import mujoco` itself fails; that has its own check.
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


def _pins(*names: str) -> str:
    return "pip install " + " ".join(f"{name}=={TESTED[name]}" for name in names)


def _print_report(checks: Iterable[Check], fit: bool) -> None:
    table = Table("check", "", "found", box=None)
    for check in checks:
        table.add_row(check.name, _mark(check), escape(check.detail))
    console = Console(soft_wrap=True)
    console.print(table)
    for check in checks:
        if not check.ok:
            console.print(f"{check.name}: {check.remedy}", markup=False)
    console.print("fit" if fit else "not fit: mend what failed and run this again")


def _mark(check: Check) -> str:
    if check.ok:
        return "[green]ok[/green]"
    return "[red]FAIL[/red]" if check.required else "[yellow]note[/yellow]"
