"""A figure of what policies see: qualities and looks of two cameras, side by side."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from manip.cameras import CameraConfig, Quality, part_name
from manip.envs.make_batch import make_batch
from manip.io.atomic_files import replace_file

Array = np.ndarray

CAMERAS = ("agentview", "robot0_eye_in_hand")
SIZE = 64
"""Height and width of the images [pixels]."""
STEPS = 14
"""Control steps of the task's expert before the image."""

COLUMNS: dict[str, tuple[Quality, float | str]] = {
    "exact": ("exact", 0.0),
    "lean": ("lean", 0.0),
    "looks 0.5": ("lean", 0.5),
    "looks 1": ("lean", 1.0),
    "unseen-textures-1": ("lean", "unseen-textures-1"),
    "unseen-lights-2": ("lean", "unseen-lights-2"),
    "unseen-cameras-1": ("lean", "unseen-cameras-1"),
}
"""Title of a column -> quality and looks of its images."""


def draw_images(task: str, path: Path) -> None:
    """Draw one state of the task in each quality and look, into a figure."""
    figure, panels = plt.subplots(
        len(CAMERAS), len(COLUMNS), figsize=(12, 3.9), layout="tight"
    )
    for column, (title, kind) in enumerate(COLUMNS.items()):
        images = _images(task, *kind)
        panels[0, column].set_title(title, fontsize=9)
        for row, camera in enumerate(CAMERAS):
            _show(panels[row, column], images[part_name(camera)])
            panels[row, 0].set_ylabel(camera, fontsize=9)
    replace_file(path, lambda part: figure.savefig(part, dpi=120))
    plt.close(figure)


def _images(task: str, quality: Quality, looks: float | str) -> dict[str, Array]:
    """Camera part -> uint8 [SIZE, SIZE, 3] of the last of a few steps."""
    cameras = CameraConfig(CAMERAS, SIZE, quality)
    batch = make_batch(task, cameras=cameras, looks=looks, seed=3)
    batch.begin(np.array([0]))
    for _ in range(STEPS):
        images = batch.step(batch.expert()).images
    return {name: image[0] for name, image in images.items()}


def _show(axes: Axes, image: Array) -> None:
    axes.imshow(image, origin="lower", interpolation="nearest")
    axes.set(xticks=[], yticks=[])
