"""Which OpenGL backend draws on this machine, and how to make mujoco use it.

A broken backend can crash a process, and mujoco binds one when it is imported. So
each is tried in a child process, and this module never imports mujoco itself.
"""

import importlib
import os
import platform
import subprocess
import sys
from functools import cache

from manip.errors import UserError

CANDIDATES = {"Linux": ("egl", "osmesa"), "Darwin": ("cgl",), "Windows": ("wgl",)}
"""Values of MUJOCO_GL that draw without a window, best first, by operating system."""

INSTALL_HINT = (
    "install EGL (Debian, Ubuntu: `apt-get install libegl1 libgl1-mesa-dri`) "
    "or OSMesa (`apt-get install libosmesa6`)"
)

_PYOPENGL_BACKENDS = ("egl", "osmesa")
_BINDING = "mujoco.rendering.classic.gl_context"
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
        raise RuntimeError("the picture is black")
"""


@cache
def find_backend() -> str | None:
    """Return the first backend that draws: the one in MUJOCO_GL, then `CANDIDATES`.

    The answer is kept for the life of the process. Returns None if nothing draws.
    """
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    usual = CANDIDATES.get(platform.system(), ())
    names = dict.fromkeys((asked, *usual) if asked else usual)
    return next(filter(_draws, names), None)


def use_backend() -> str:
    """Make mujoco draw with `find_backend()`, whatever it was imported with.

    Sets MUJOCO_GL and PYOPENGL_PLATFORM. Call it before the first renderer.

    Raises:
        UserError: no backend draws here; the message says what to install.
    """
    backend = find_backend()
    if backend is None:
        raise UserError(f"no OpenGL backend can draw pictures here: {INSTALL_HINT}")
    os.environ.update(_settings(backend))
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
    """Let an imported mujoco read MUJOCO_GL anew; its Renderer looks it up late."""
    binding = sys.modules.get(_BINDING)
    if binding is not None:
        importlib.reload(binding)
