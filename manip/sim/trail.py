"""Draw where a site was in the frames before: the spacing of the dots shows its speed,
and their line how smoothly it moved.
"""

import math

import mujoco
import numpy as np
from PIL import Image, ImageDraw

_DOT = (255, 140, 0)
_EDGE = (60, 30, 0)


class Trail:
    """The path of a site in the images of one camera.

    Args:
        site: name of the site.
        view: the camera, fixed or free.
    """

    def __init__(self, site: str, view: mujoco.MjvCamera) -> None:
        self._site, self._view = site, view
        self._points: list[np.ndarray] = []

    def draw(
        self, model: mujoco.MjModel, data: mujoco.MjData, frame: np.ndarray
    ) -> np.ndarray:
        """Add the site's present place; return the frame [H, W, 3] with all places."""
        self._points.append(data.site(self._site).xpos.copy())
        height, width, _ = frame.shape
        image = Image.fromarray(frame)
        canvas, radius = ImageDraw.Draw(image), max(1.5, height / 200)
        places = _pixels(np.array(self._points), model, data, self._view, height)
        for x, y in places + np.array([width, height]) / 2:
            box = (x - radius, y - radius, x + radius, y + radius)
            canvas.ellipse(box, _DOT, _EDGE)
        return np.asarray(image)


def _pixels(
    points: np.ndarray,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    view: mujoco.MjvCamera,
    height: int,
) -> np.ndarray:
    """[P, 2]: where points [P, 3] are, right of and below the image's centre."""
    place, right, up, ahead, fovy = _lens(model, data, view)
    focus = height / 2 / math.tan(math.radians(fovy) / 2)
    offsets = points - place
    depth = np.maximum(offsets @ ahead, 1e-3)  # points behind the camera: at its edge
    return focus * np.stack([offsets @ right, -offsets @ up], 1) / depth[:, None]


def _lens(
    model: mujoco.MjModel, data: mujoco.MjData, view: mujoco.MjvCamera
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Place [3] m, three axes [3] and vertical field of view [degree] of a camera."""
    if view.type == mujoco.mjtCamera.mjCAMERA_FIXED:
        camera = view.fixedcamid
        right, up, back = data.cam_xmat[camera].reshape(3, 3).T
        return data.cam_xpos[camera], right, up, -back, model.cam_fovy[camera]
    azimuth, elevation = math.radians(view.azimuth), math.radians(view.elevation)
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0])
    ahead = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    place = view.lookat - view.distance * ahead
    return place, right, np.cross(right, ahead), ahead, model.vis.global_.fovy
