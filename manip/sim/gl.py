"""Find an OpenGL backend that draws on this machine, and make mujoco use it.

mujoco reads MUJOCO_GL when it is imported. A broken backend can crash a process, so
each one is tried in a child process.
"""

import importlib
import os
import platform
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache

from manip.errors import UserError, one_line

CANDIDATES = {"Linux": ("egl", "osmesa"), "Darwin": ("cgl",), "Windows": ("wgl",)}
"""Values of MUJOCO_GL that draw without a window, best first, by operating system."""

INSTALL_HINT = (
    "install EGL (Debian, Ubuntu: `apt-get install libegl1 libgl1-mesa-dri`) "
    "or OSMesa (`apt-get install libosmesa6`)"
)

_PYOPENGL_BACKENDS = ("egl", "osmesa")
_BINDING = "mujoco.rendering.classic.gl_context"
_RENDERER = "mujoco.rendering.classic.renderer"
_PROBE_SECONDS = 30
_PROBE = """
import mujoco
xml = "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"
model = mujoco.MjModel.from_xml_string(xml)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 16, 16) as renderer:
    renderer.update_scene(data)
    if not renderer.render().any():
        raise RuntimeError("the image is black")
"""


@contextmanager
def keep_mujoco_gl(value: str | None = None) -> Iterator[None]:
    """Put MUJOCO_GL back after the `with` block; set it to a value for the block."""
    before = os.environ.get("MUJOCO_GL")
    if value is not None:
        os.environ["MUJOCO_GL"] = value
    try:
        yield
    finally:
        os.environ.pop("MUJOCO_GL", None)
        if before is not None:
            os.environ["MUJOCO_GL"] = before


def import_mujoco() -> None:
    """Import mujoco; without OpenGL and with a warning if MUJOCO_GL makes it fail.

    `use_backend` chooses another backend then. Errors that have another cause occur
    again in the next import of mujoco.
    """
    try:
        importlib.import_module("mujoco")
    except Exception as error:
        with keep_mujoco_gl("off"), suppress(Exception):
            importlib.import_module("mujoco")
        warnings.warn(
            f"MUJOCO_GL={os.environ['MUJOCO_GL']} is not used: {one_line(error)}",
            stacklevel=3,
        )


@cache
def find_backend() -> str | None:
    """Return the first backend that draws: the one in MUJOCO_GL, then `CANDIDATES`.

    None if none draws. Each process searches once.
    """
    chosen = os.environ.get("MUJOCO_GL", "").strip().lower()
    usual = CANDIDATES.get(platform.system(), ())
    names = dict.fromkeys((chosen, *usual) if chosen else usual)
    return next(filter(_draws, names), None)


def use_backend() -> str:
    """Make mujoco draw with `find_backend()`, also if it was imported with another.

    Sets MUJOCO_GL, PYOPENGL_PLATFORM and, unless it is set, LP_NUM_THREADS: Mesa's
    software renderer would start threads of its own, which draw small images no
    faster. Call it before the first renderer.

    Raises:
        UserError: no backend draws here; the message lists the packages to install.
    """
    backend = find_backend()
    if backend is None:
        raise UserError(f"no OpenGL backend can draw images here: {INSTALL_HINT}")
    os.environ.update(_settings(backend))
    os.environ.setdefault("LP_NUM_THREADS", "0")
    _bind_again()
    return backend


def _draws(backend: str) -> bool:
    command = [sys.executable, "-c", _PROBE]
    environment = os.environ | _settings(backend)
    try:
        probe = subprocess.run(
            command, env=environment, capture_output=True, timeout=_PROBE_SECONDS
        )
    except subprocess.TimeoutExpired:
        return False
    return probe.returncode == 0


def _settings(backend: str) -> dict[str, str]:
    if backend in _PYOPENGL_BACKENDS:
        return {"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
    return {"MUJOCO_GL": backend}


def _bind_again() -> None:
    """Make an imported mujoco read MUJOCO_GL again, which its Renderer uses later.

    mujoco is imported without its Renderer where PYOPENGL_PLATFORM contradicts
    MUJOCO_GL.
    """
    binding, mujoco = sys.modules.get(_BINDING), sys.modules.get("mujoco")
    if binding is not None:
        importlib.reload(binding)
    if mujoco is not None and not hasattr(mujoco, "Renderer"):
        vars(mujoco)["Renderer"] = importlib.import_module(_RENDERER).Renderer
