"""Compare the images that the native backend draws with robosuite's own.

Images per CPU second: the CPU time of all threads, so that other work on the machine
changes the figures little.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from manip.benchmarks.camera_images import draw_images
from manip.benchmarks.engine_steps import (
    engine_at_start,
    random_actions,
    scene_of,
)
from manip.benchmarks.rounds import Candidate, Comparison, Measurements, Settings
from manip.cameras import CameraConfig, Quality
from manip.envs.task_registry import load_task
from manip.robot_config import RobotConfig
from manip.sim.scene import Scene
from manip.sim.scene_cameras import SceneCameras
from manip.sim.stock_driver import open_stock

Array = np.ndarray

CAMERAS = ("agentview", "robot0_eye_in_hand")
SIZES = (32, 64, 128)
"""Height and width of the images [pixels]."""
FRAMES = {"robosuite": 15, "exact": 15, "lean": 60}
"""Frames in one measurement, about half a second."""
STATES = 4


def comparison(settings: Settings) -> Comparison:
    """Compare robosuite's images of two cameras with exact and lean ones."""
    scene, states = _states(settings.task)
    candidates: dict[str, Candidate] = {}
    ratios: dict[str, tuple[str, str]] = {}
    for camera in CAMERAS:
        for size in SIZES:
            names = {kind: f"{camera} {size} {kind}" for kind in FRAMES}
            candidates[names["robosuite"]] = _stock(settings.task, camera, size)
            for quality in ("exact", "lean"):
                drawn = SceneCameras(scene, CameraConfig((camera,), size, quality))
                candidates[names[quality]] = _native(drawn, states, quality)
                ratio = f"{camera}_{size}_{quality}_vs_robosuite"
                ratios[ratio] = names[quality], names["robosuite"]
    return Comparison(
        f"{settings.task}, one image after another",
        candidates,
        ratios=ratios,
        unit="images per CPU second",
        task=settings.task,
    )


def plot(measurements: Measurements, path: Path) -> None:
    """Draw the images themselves: see `manip.benchmarks.camera_images`."""
    draw_images(measurements.comparison.task, path)


def _states(task: str) -> tuple[Scene, Array]:
    """States after 20 random actions."""
    scene = scene_of(task)
    engine = engine_at_start(task, scene, STATES, threads=1)
    for action in random_actions(scene, STATES)[:20]:
        engine.step(action)
    return scene, engine.states.copy()


def _native(drawn: SceneCameras, states: Array, quality: Quality) -> Candidate:
    frames = FRAMES[quality]
    rows = states[np.arange(frames) % STATES]
    return _frame_rate(frames, partial(drawn.draw, rows))


def _stock(task: str, camera: str, size: int) -> Candidate:
    """robosuite's `sim.render`, which its camera observations call."""
    cameras = CameraConfig((camera,), size)
    name = load_task(task).robosuite_name
    driver = open_stock(name, RobotConfig(), 0, cameras)
    driver.run(driver.stock.reset)
    sim, frames = driver.stock.sim, FRAMES["robosuite"]

    def run() -> None:
        for _ in range(frames):
            sim.render(width=size, height=size, camera_name=camera)

    return _frame_rate(frames, partial(driver.run, run))


def _frame_rate(frames: int, draw: Callable[[], object]) -> Candidate:
    def measure() -> float:
        start = time.process_time()
        draw()
        return frames / (time.process_time() - start)

    return measure
