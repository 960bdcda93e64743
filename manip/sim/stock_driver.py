"""Run robosuite environments, with or without cameras, with their own OpenGL context.

robosuite makes its OpenGL context current only once, when it builds it: with another
context current its images are silently wrong. It also leaves the context of a model
that a hard reset replaces to the garbage collector, which then deletes textures of
whatever context is current (utils/binding_utils.py).
"""

import gc
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

from manip.cameras import CameraConfig
from manip.errors import UserError, unknown
from manip.robot_config import RobotConfig
from manip.sim.gl import use_backend
from manip.sim.gl_thread import InGLThread
from manip.sim.not_copied import NotCopied
from manip.sim.robosuite_factory import draw_with, make_stock

Result = TypeVar("Result")


class StockDriver(NotCopied):
    """Run functions of a robosuite environment in the calling thread.

    Args:
        stock: the environment.
    """

    def __init__(self, stock: Any) -> None:
        self.stock = stock

    def run(self, function: Callable[[], Result]) -> Result:
        """Call a function that steps or resets the environment."""
        before = self._context()
        if before is None:
            return function()
        before.gl_ctx.make_current()
        result = function()
        if self._context() is not before:
            _free(before)
            del before
            gc.collect()  # the replaced model is in reference cycles of 300 MB
        return result

    def close(self) -> None:
        """Free the OpenGL context."""
        _free(self._context())

    def _context(self) -> Any:
        return self.stock.sim._render_context_offscreen


class CameraDriver(StockDriver):
    """Build and run an environment with cameras in the process's OpenGL thread.

    Args:
        make: builds the environment.
    """

    def __init__(self, make: Callable[[], Any]) -> None:
        self._inner = InGLThread(lambda: StockDriver(make()))
        super().__init__(self._inner.opened.stock)

    def run(self, function: Callable[[], Result]) -> Result:
        """Call a function that steps or resets the environment."""
        return self._inner.call(lambda: self._inner.opened.run(function))


def open_stock(
    name: str, robot: RobotConfig, seed: int | None, cameras: CameraConfig, **more: Any
) -> StockDriver:
    """Build `robosuite.make(name, ...)` that observes cameras; `more` as in make_stock.

    Raises:
        UserError: a camera does not exist, or no OpenGL backend works here.
    """
    if not cameras.names:
        return StockDriver(make_stock(name, robot, seed, **more))
    for camera in cameras.names:
        if camera not in _cameras(name, robot):
            raise unknown("camera", camera, _cameras(name, robot))
    draw_with(use_backend())
    options = camera_options(cameras) | more
    return CameraDriver(lambda: make_stock(name, robot, seed, **options))


def camera_options(cameras: CameraConfig) -> dict[str, Any]:
    """The options of `robosuite.make` that observe the cameras."""
    return {
        "use_camera_obs": True,
        "has_offscreen_renderer": True,
        "camera_names": list(cameras.names),
        "camera_heights": cameras.size,
        "camera_widths": cameras.size,
    }


def check_stock_cameras(stock: Any, cameras: CameraConfig) -> None:
    """Raise `UserError` unless an environment observes the cameras in their size."""
    sizes = zip(stock.camera_heights, stock.camera_widths, strict=True)
    given = dict(zip(stock.camera_names, sizes, strict=True))
    size = cameras.size
    for name in cameras.names:
        if not stock.use_camera_obs or given.get(name) != (size, size):
            raise UserError(
                f"the robosuite environment does not observe {name} with {size} x "
                f"{size} pixels: build it with {camera_options(cameras)}"
            )


@cache
def _cameras(name: str, robot: RobotConfig) -> tuple[str, ...]:
    """Cameras of an environment; robosuite would log an error for an unknown one."""
    model = make_stock(name, robot).sim.model._model
    return tuple(model.camera(index).name for index in range(model.ncam))


def _free(context: Any) -> None:
    context.gl_ctx.make_current()
    context.con.free()
    context.gl_ctx.free()
