"""Drawing beside other users of OpenGL in the same process."""

import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from pendulum import PENDULUM

from manip.sim import gl
from manip.sim.drawer import Drawer
from manip.sim.renderer import render_frames

draws = pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)


@pytest.fixture
def pendulum() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(PENDULUM)


def in_python(code: str) -> subprocess.CompletedProcess[str]:
    backend = gl.find_backend() or ""
    return subprocess.run(
        [sys.executable, "-c", f"XML = {PENDULUM!r}\n{code}"],
        env=os.environ | {"MUJOCO_GL": backend},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


LEFT_OPEN = """
import mujoco, numpy as np
from manip.sim.renderer import render_frames
model = mujoco.MjModel.from_xml_string(XML)
films = [render_frames(model, np.zeros((2, 1)), "front", 64, 48) for _ in range(2)]
print(*(next(film).shape for film in films))
"""

LEFT_OPEN_BESIDE_ANOTHER = (
    LEFT_OPEN
    + """
other = mujoco.Renderer(model, 48, 64)  # its OpenGL ends after ours
other.close()
import atexit
if hasattr(mujoco, "egl"):
    atexit.register(mujoco.egl.EGL.eglTerminate, mujoco.egl.EGL_DISPLAY)
"""
)

ANOTHER_CONTEXT = """
import mujoco, numpy as np
from manip.sim.gl import use_backend
from manip.sim.renderer import render_frames
use_backend()
from mujoco.rendering.classic import gl_context
model = mujoco.MjModel.from_xml_string(XML)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
context = gl_context.GLContext(64, 48)
context.make_current()
drawing = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150)
mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, drawing)
scene, area = mujoco.MjvScene(model, 100), mujoco.MjrRect(0, 0, 64, 48)

def draw():
    view, options = mujoco.MjvCamera(), mujoco.MjvOption()
    view.distance = 3
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, options, None, view, everything, scene)
    picture = np.zeros((48, 64, 3), np.uint8)
    mujoco.mjr_render(area, scene, drawing)
    mujoco.mjr_readPixels(picture, None, area, drawing)
    return picture

first = draw()
film = render_frames(model, np.zeros((3, 1)), "front", 64, 48)
next(film)
between = draw()
next(film)
film.close()
after = draw()
print(first.std() > 1, (between == first).all(), (after == first).all())
drawing.free()
context.free()
"""


@draws
@pytest.mark.parametrize("code", [LEFT_OPEN, LEFT_OPEN_BESIDE_ANOTHER])
def test_renderers_left_open_end_without_a_word(code: str) -> None:
    done = in_python(code)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split("\n")[0] == "(48, 64, 3) (48, 64, 3)"


@draws
def test_another_librarys_context_stays_current() -> None:
    done = in_python(ANOTHER_CONTEXT)
    assert done.stdout.strip() == "True True True", done.stderr


@draws
def test_a_closed_film_has_ended(pendulum: mujoco.MjModel) -> None:
    frames = render_frames(pendulum, np.zeros((2, 1)), "front")
    next(frames)
    frames.close()
    assert list(frames) == []


@draws
def test_an_error_of_opengl_reaches_the_caller(pendulum: mujoco.MjModel) -> None:
    with pytest.raises(ValueError, match="framebuffer"):
        Drawer(pendulum, 10**5, 10**5)


@draws
def test_a_platform_that_contradicts_mujocos_backend_is_replaced() -> None:
    """mujoco is imported without its Renderer then, and without a word."""
    code = "from manip.sim.gl import import_mujoco, use_backend; import_mujoco();"
    code += "use_backend(); import mujoco; print(mujoco.Renderer.__name__)"
    variables = {"MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "egl"}
    result = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.stdout == "Renderer\n", result.stderr
