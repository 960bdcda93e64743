"""Frames, captions, animation files, and the choice of the OpenGL backend."""

import os
import platform
from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import mujoco
import numpy as np
import pytest
from mujoco.rendering.classic import gl_context
from pendulum import PENDULUM
from PIL import Image

from manip.errors import UserError
from manip.io.video import Caption, draw_caption, save_animation
from manip.programs.film import beside
from manip.sim import gl
from manip.sim.renderer import camera_names, hide_decorations, render_frames
from manip.sim.robosuite_factory import make_stock

draws = pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)


@pytest.fixture
def pendulum() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(PENDULUM)


@pytest.fixture
def frames() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return list(rng.integers(0, 256, (7, 48, 64, 3), dtype=np.uint8))


@pytest.fixture
def fresh_search(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for variable in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):
        monkeypatch.setenv(variable, "")
    monkeypatch.setattr(platform, "system", lambda: "Linux")
    gl.find_backend.cache_clear()
    yield
    gl.find_backend.cache_clear()


def has_colour(frame: np.ndarray, channel: int) -> bool:
    others = np.delete(frame, channel, axis=-1).max(axis=-1)
    return bool((frame[..., channel] > others.astype(int) + 60).any())


@draws
def test_a_moving_robosuite_arm_is_drawn() -> None:
    env = make_stock("Lift")
    model, start = env.sim.model._model, env.sim.data._data.qpos
    states = np.stack([start, start])
    states[1, 0] += 0.5
    still, moved = render_frames(model, states, width=160, height=120)
    assert still.shape == moved.shape == (120, 160, 3)
    assert still.dtype == np.uint8
    assert still.mean() > 30
    assert np.abs(still.astype(int) - moved).max() > 30


@draws
def test_only_visual_geoms_and_goals_are_drawn(pendulum: mujoco.MjModel) -> None:
    (frame,) = render_frames(pendulum, np.zeros((1, 1)), "front")
    red, green, blue = (has_colour(frame, channel) for channel in range(3))
    assert (red, green, blue) == (True, False, False)


@draws
def test_frames_may_exceed_the_model_buffer_and_leave_it(
    pendulum: mujoco.MjModel,
) -> None:
    before = pendulum.vis.global_.offwidth, pendulum.site_rgba.copy()
    (frame,) = render_frames(pendulum, np.zeros((1, 1)), "front", 800, 600)
    assert frame.shape == (600, 800, 3)
    assert pendulum.vis.global_.offwidth == before[0]
    np.testing.assert_array_equal(pendulum.site_rgba, before[1])


@draws
def test_each_state_has_one_caption(pendulum: mujoco.MjModel) -> None:
    frames = render_frames(pendulum, np.zeros((2, 1)), captions=[Caption("one")])
    with pytest.raises(ValueError, match="shorter"):
        list(frames)


@draws
@pytest.mark.parametrize(
    ("camera", "place"),
    [
        ("front", (0.3, 0, 0.4)),
        pytest.param("workspace", (0.1, 0.2, 1.2), marks=pytest.mark.slow),
        pytest.param("closeup", (-0.1, 0.1, 1.1), marks=pytest.mark.slow),
    ],
)
def test_a_trail_has_its_dots_where_the_site_is_drawn(
    pendulum: mujoco.MjModel, camera: str, place: tuple[float, ...]
) -> None:
    pendulum.site("goal").pos[:], pendulum.site("goal").size[:] = place, 0.02
    states = np.zeros((1, 1))
    (plain,) = render_frames(pendulum, states, camera)
    (dotted,) = render_frames(pendulum, states, camera, trail="goal")
    red = plain[..., 0] > plain[..., 1].astype(int) + 30
    changed = (plain != dotted).any(-1)
    centres = [np.argwhere(mask).mean(0) for mask in (red, changed)]
    np.testing.assert_allclose(*centres, atol=2)


@draws
def test_a_trail_keeps_the_places_of_earlier_frames(pendulum: mujoco.MjModel) -> None:
    states = np.zeros((3, 1))
    plain = render_frames(pendulum, states, "front")
    dotted = render_frames(pendulum, states, "front", trail="goal")
    sizes = [(a != b).any(-1).sum() for a, b in zip(plain, dotted, strict=True)]
    assert sizes[0] == sizes[2] > 0  # the site stands: dots on one place


def test_hidden_sites_have_no_alpha(pendulum: mujoco.MjModel) -> None:
    hide_decorations(pendulum)
    assert pendulum.site("marker").rgba[3] == 0
    assert pendulum.site("goal").rgba[3] == 1


def test_unknown_camera_lists_the_cameras(pendulum: mujoco.MjModel) -> None:
    assert camera_names(pendulum) == ("workspace", "closeup", "front")
    known = "did you mean 'front'\\? known cameras: workspace, closeup, front"
    with pytest.raises(UserError, match=f"unknown camera 'frnt': {known}"):
        render_frames(pendulum, np.zeros((1, 1)), "frnt")


def test_success_frames_the_picture_in_green() -> None:
    frame = np.full((120, 160, 3), 200, np.uint8)
    plain, success = (draw_caption(frame, Caption("x", flag)) for flag in (False, True))
    assert (frame == 200).all()
    assert (plain != frame).any()
    assert (plain[0] == 200).all()
    assert (success[0, :, 1] > success[0, :, 0]).all()


def test_mp4_has_every_frame(tmp_path: Path, frames: list[np.ndarray]) -> None:
    path = tmp_path / "new" / "clip.mp4"
    save_animation(path, iter(frames), fps=20)
    reader = imageio_ffmpeg.read_frames(path)
    properties = next(reader)
    assert properties["size"] == (64, 48)
    assert properties["fps"] == 20
    assert len(list(reader)) == len(frames)
    assert list(path.parent.iterdir()) == [path]


def test_gif_has_every_frame(tmp_path: Path, frames: list[np.ndarray]) -> None:
    path = tmp_path / "clip.gif"
    save_animation(path, iter(frames), fps=20)
    with Image.open(path) as image:
        assert image.n_frames == len(frames)
        assert image.info["duration"] == 50
    assert list(tmp_path.iterdir()) == [path]


def test_small_bright_objects_keep_their_colour_in_a_gif(tmp_path: Path) -> None:
    grey = np.random.default_rng(0).integers(90, 200, (240, 320, 1), dtype=np.uint8)
    frame = np.repeat(grey, 3, axis=-1)
    frame[100:106, 100:106] = (200, 30, 30)
    save_animation(tmp_path / "clip.gif", [frame], fps=20)
    with Image.open(tmp_path / "clip.gif") as image:
        assert has_colour(np.asarray(image.convert("RGB")), 0)


def test_a_failure_while_drawing_leaves_no_file(
    tmp_path: Path, frames: list[np.ndarray]
) -> None:
    def broken() -> Iterator[np.ndarray]:
        yield frames[0]
        raise RuntimeError("lost the context")

    with pytest.raises(RuntimeError, match="lost the context"):
        save_animation(tmp_path / "clip.mp4", broken(), fps=20)
    assert list(tmp_path.iterdir()) == []


def test_unknown_suffix_lists_the_formats(tmp_path: Path) -> None:
    known = r"known animation formats: \.mp4, \.gif"
    with pytest.raises(UserError, match=f"unknown animation format '.avi': {known}"):
        save_animation(tmp_path / "clip.avi", [], fps=20)


def test_no_frames_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no frames to write to .*clip\.mp4"):
        save_animation(tmp_path / "clip.mp4", [], fps=20)


@pytest.mark.usefixtures("fresh_search")
@pytest.mark.parametrize(
    ("chosen", "working", "expected"),
    [
        ("", {"egl", "osmesa"}, "egl"),
        ("", {"osmesa"}, "osmesa"),
        ("OSMesa", {"egl", "osmesa"}, "osmesa"),
        ("glfw", {"egl", "glfw"}, "glfw"),
        ("glfw", {"egl"}, "egl"),
        ("egl", set(), None),
    ],
)
def test_the_chosen_backend_is_tried_first(
    chosen: str,
    working: set[str],
    expected: str | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("MUJOCO_GL", chosen)
    monkeypatch.setattr(gl, "_draws", working.__contains__)
    assert gl.find_backend() == expected


@pytest.mark.usefixtures("fresh_search")
def test_no_backend_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl, "_draws", lambda backend: False)
    with pytest.raises(UserError, match=r"libegl1 .*libosmesa6"):
        gl.use_backend()


@draws
def test_an_imported_mujoco_switches_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl_context, "GLContext", None)
    backend = gl.use_backend()
    assert os.environ["MUJOCO_GL"] == backend
    assert gl_context.GLContext.__module__ == f"mujoco.{backend}"


def test_the_images_of_a_policy_stand_beside_a_frame_the_right_way_up() -> None:
    frame = np.full((6, 4, 3), 7, np.uint8)
    upper, lower = (np.zeros((3, 3, 6), np.uint8) for _ in range(2))
    upper[0, :, -3:] = 100  # the first row of an image is its bottom
    lower[..., :3] = 200  # of an earlier image
    shown = beside(frame, [upper, lower])
    assert shown.shape == (6, 7, 3)
    assert (shown[:, :4] == 7).all()
    assert (shown[2, 4:] == 100).all()
    assert (shown[[0, 1, 3, 4, 5], 4:] == 0).all()
