"""Cameras: robosuite's images from every backend, byte for byte."""

import copy
import gc
import os
import subprocess
import sys
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torchrl.envs import check_env_specs

from manip.cameras import CameraConfig
from manip.envs import TaskEnv, load_task, make_batch
from manip.envs.task_batch import TaskBatch
from manip.errors import UserError
from manip.robot_config import RobotConfig
from manip.sim import gl
from manip.sim.batch_engine import BatchEngine
from manip.sim.robosuite_factory import draw_with, make_stock
from manip.sim.scene import Scene, load_scene
from manip.sim.scene_cameras import SceneCameras
from manip.sim.stock_driver import camera_options, open_stock
from manip.sim.stock_reader import stock_reader

pytestmark = pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)

Array = np.ndarray

WRIST, TABLE = "robot0_eye_in_hand", "agentview"
BOTH = (TABLE, WRIST)
SMALL = CameraConfig(BOTH, 32)


def state_of(batch: TaskBatch) -> Array:
    """The engine's state row of a stock environment, without the task's memory."""
    stock = batch.stock
    data, read = stock.sim.data._data, stock_reader(stock, batch.task.sensors)()
    names = ("start_pos", "gripper_command", *batch.task.sensors.fields)
    hidden = (read[name][0] for name in names)
    return np.concatenate([data.qpos, data.qvel, data.qacc_warmstart, *hidden])


def rows_after(engine: BatchEngine, state: Array) -> Array:
    """The state after another one, whose fields and pose differ from it."""
    rows = engine.states.copy()
    rows[1, : len(state)] = state
    return rows


def played(batch: TaskBatch, resets: int, steps: int) -> Iterator[dict[str, Array]]:
    """Images [1, H, W, 3] at resets and after random steps."""
    rng = np.random.default_rng(0)
    for _ in range(resets):
        batch.begin(np.array([0]))
        yield batch.observe().images
        for _ in range(steps):
            yield batch.step(rng.uniform(-1, 1, (1, batch.action_dim))).images


def assert_images_are_robosuites(name: str, size: int, resets: int, steps: int) -> None:
    task, cameras = load_task(name), CameraConfig(BOTH, size)
    stock = make_batch(task, backend="stock", cameras=cameras)
    native = make_batch(task, 2, seed=5)
    native.begin(np.arange(2))
    drawn = SceneCameras(native.scene, cameras)
    for theirs in played(stock, resets, steps):
        ours = drawn.draw(rows_after(native.engine, state_of(stock)))
        for part in theirs:
            np.testing.assert_array_equal(ours[part][1], theirs[part][0])
            assert (ours[part][0] != theirs[part][0]).any()


def test_images_are_robosuites_byte_for_byte() -> None:
    assert_images_are_robosuites("Lift", 32, resets=2, steps=1)


@pytest.mark.slow
@pytest.mark.parametrize("size", [32, 64, 128])
@pytest.mark.parametrize("name", ["Lift", "PickPlaceCan", "Door"])
def test_every_image_of_two_episodes_is_robosuites(name: str, size: int) -> None:
    assert_images_are_robosuites(name, size, resets=2, steps=20)


@pytest.fixture(scope="module")
def lift_scene() -> Scene:
    return load_scene("Lift", load_task("Lift").sensors)


@pytest.fixture(scope="module")
def lean(lift_scene: Scene) -> TaskBatch:
    """Three environments with two stacked images of the wrist."""
    return make_batch(
        "Lift",
        3,
        scene=lift_scene,
        horizon=4,
        cameras=CameraConfig((WRIST,), 16, "lean", frames=2),
    )


PART = f"{WRIST}_image"


def actions(batch: TaskBatch, seed: int) -> Array:
    shape = batch.num_envs, batch.action_dim
    return np.random.default_rng(seed).uniform(-1, 1, shape)


def test_images_of_a_batch_are_those_of_single_environments(lean: TaskBatch) -> None:
    lean.begin(np.arange(3))
    lean.step(actions(lean, 0))
    together = lean.step(actions(lean, 1)).images[PART][..., 3:]
    alone = [lean._drawn.draw(lean.engine.states[[i]])[PART][0] for i in range(3)]
    np.testing.assert_array_equal(together, alone)


def test_a_stack_begins_with_copies_and_ends_with_the_latest(lean: TaskBatch) -> None:
    lean.begin(np.arange(3))
    first = lean.observe().images[PART]
    np.testing.assert_array_equal(first[..., :3], first[..., 3:])
    second = lean.step(actions(lean, 0)).images[PART]
    np.testing.assert_array_equal(second[..., :3], first[..., 3:])
    assert (second[..., 3:] != first[..., 3:]).any(axis=(1, 2, 3)).all()


def test_a_restart_redraws_its_environments_only(lean: TaskBatch) -> None:
    lean.begin(np.arange(3))
    last = lean.step(actions(lean, 0)).images[PART]
    before = last.copy()
    lean.begin(np.array([1]))
    now = lean.observe().images[PART]
    np.testing.assert_array_equal(last, before)
    np.testing.assert_array_equal(now[[0, 2]], last[[0, 2]])
    np.testing.assert_array_equal(now[1, ..., :3], now[1, ..., 3:])
    assert (now[1] != last[1]).any()


def test_a_saved_state_repeats_its_images(lean: TaskBatch) -> None:
    lean.begin(np.arange(3))
    lean.step(actions(lean, 0))
    state = copy.deepcopy(lean.save_state())
    expected = [lean.step(actions(lean, s)).images[PART] for s in (1, 2)]
    lean.begin(np.arange(3))
    lean.load_state(state)
    again = [lean.step(actions(lean, s)).images[PART] for s in (1, 2)]
    np.testing.assert_array_equal(again, expected)


def test_a_state_without_images_is_refused(lean: TaskBatch) -> None:
    lean.begin(np.arange(3))
    state = lean.save_state()
    del state["images"]
    with pytest.raises(UserError, match=f"no {PART}"):
        lean.load_state(state)


def test_an_environment_that_breaks_shows_its_last_state(lean: TaskBatch) -> None:
    lean.begin(np.arange(3))
    first = lean.observe().images[PART]
    action = actions(lean, 0)
    action[1] = np.nan
    images = lean.step(action).images[PART]
    np.testing.assert_array_equal(images[1], first[1])
    assert (images[0] != first[0]).any()


def test_torchrl_gives_images_under_their_parts_names(lean: TaskBatch) -> None:
    env = TaskEnv(lean)
    check_env_specs(env)
    step = env.rollout(5, break_when_any_done=False)
    parts = env.parts(step["next"])
    assert list(parts) == list(lean.observation_spec.names)
    assert parts[PART].shape == (3, 5, 16, 16, 6)
    ended = step["next", "done"][:, 3, 0]
    after = step[PART][:, 4]
    assert ended.all()
    assert (after[..., :3] == after[..., 3:]).all()
    assert (step["next", PART][:, 3] != after).any()


@pytest.mark.slow
def test_lean_images_are_close_to_exact_ones(lift_scene: Scene) -> None:
    engine = BatchEngine(lift_scene, 2)
    exact = SceneCameras(lift_scene, SMALL).draw(engine.states)
    lean = SceneCameras(lift_scene, CameraConfig(BOTH, 32, "lean")).draw(engine.states)
    gaps = {part: np.abs(exact[part] - lean[part].astype(float)) for part in exact}
    assert gaps[f"{WRIST}_image"].max() <= 12
    assert 0 < gaps[f"{TABLE}_image"].mean() < 4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"names": "agentview"}, "must be a list, not 'agentview'"),
        ({"names": ("agentview", "agentview")}, "named twice: agentview"),
        ({"names": (1,)}, "must be text, not 1"),
        ({"size": 4}, "size of an image .* from 8 to 1024, not 4"),
        ({"size": 64.0}, "from 8 to 1024, not 64.0"),
        ({"frames": 0}, "frames must be a whole number from 1 to 16, not 0"),
        ({"quality": "best"}, "unknown image quality 'best': .*exact, lean"),
    ],
)
def test_options_out_of_range_are_refused(options: dict, message: str) -> None:
    with pytest.raises(UserError, match=message):
        CameraConfig(**options)


@pytest.mark.parametrize("backend", ["native", "stock"])
def test_an_unknown_camera_is_named_with_those_that_exist(backend: str) -> None:
    with pytest.raises(UserError, match=r"'agentvew': did you mean 'agentview'\?.*eye"):
        make_batch("Lift", backend=backend, cameras=CameraConfig(("agentvew",)))


def test_without_opengl_the_error_says_what_to_install(
    lift_scene: Scene, monkeypatch
) -> None:
    monkeypatch.setattr(gl, "find_backend", lambda: None)
    with pytest.raises(UserError, match=r"no OpenGL backend .* install EGL"):
        make_batch("Lift", scene=lift_scene, cameras=SMALL)


def test_a_users_environment_must_observe_the_cameras(lift_scene: Scene) -> None:
    with pytest.raises(UserError, match="does not observe agentview with 32 x 32"):
        make_batch("Lift", backend="stock", stock=lift_scene.stock, cameras=SMALL)


def with_cameras(cameras: CameraConfig) -> Any:
    """A robosuite environment with cameras, as a user builds it."""
    draw_with(gl.use_backend())
    return make_stock("Lift", seed=0, **camera_options(cameras))


def test_a_hard_reset_frees_the_model_that_it_replaces() -> None:
    driver = open_stock("Lift", RobotConfig(), 0, SMALL, hard_reset=True)
    replaced = weakref.ref(driver.stock.sim)
    driver.run(driver.stock.reset)
    assert replaced() is None


@pytest.mark.slow
def test_renderers_work_side_by_side() -> None:
    users = with_cameras(SMALL)
    alone = [users.reset(), *(users.step(np.zeros(7))[0] for _ in range(3))]
    del users
    gc.collect()  # robosuite frees its context now, not while another one draws
    users = with_cameras(SMALL)
    options = {"cameras": SMALL, "seed": 1}
    batches = [
        make_batch("Lift", 2, **options),
        make_batch("Door", 2, **options),
        make_batch("Lift", backend="stock", **options, hard_reset=True),
        make_batch("Door", backend="stock", **options),
    ]
    seen = []
    for step in range(4):
        theirs = users.step(np.zeros(7))[0] if step else users.reset()
        for name in (f"{TABLE}_image", f"{WRIST}_image"):
            np.testing.assert_array_equal(theirs[name], alone[step][name])
        for batch in batches:
            if step % 2 == 0:
                batch.begin(np.arange(batch.num_envs))
        seen.append([batch.observe().images[f"{TABLE}_image"] for batch in batches])
    again = make_batch("Lift", backend="stock", **options, hard_reset=True)
    again.begin(np.array([0]))
    first = again.observe().images[f"{TABLE}_image"]
    np.testing.assert_array_equal(seen[0][2], first)


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
def test_memory_is_flat_over_ten_thousand_images(lift_scene: Scene) -> None:
    batch = make_batch(
        "Lift", 50, scene=lift_scene, cameras=CameraConfig((WRIST,), 32, "lean")
    )
    batch.begin(np.arange(50))
    for step in range(220):
        if step == 20:
            before = resident_bytes()
        batch.step(actions(batch, step))
    assert resident_bytes() - before < 16 << 20


@pytest.mark.slow
def test_closed_batches_free_their_memory(lift_scene: Scene) -> None:
    sizes = []
    for _ in range(6):
        batch = make_batch("Lift", scene=lift_scene, cameras=SMALL)
        batch.begin(np.array([0]))
        del batch
        sizes.append(resident_bytes())
    assert sizes[-1] - sizes[2] < 100 << 20


OPEN = """
import numpy as np
from manip.cameras import CameraConfig
from manip.envs import make_batch
cameras = CameraConfig(("agentview",), 16)
batches = [make_batch({task!r}, 1, cameras=cameras, **options) for options in {options}]
for batch in batches:
    batch.begin(np.array([0]))
    print(batch.observe().images["agentview_image"].any())
"""


def assert_ends_in_silence(task: str, options: list[dict]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", OPEN.format(task=task, options=options)],
        env=os.environ | {"MUJOCO_GL": gl.find_backend() or ""},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == ["True"] * len(options)


@pytest.mark.slow
def test_open_renderers_end_without_a_word() -> None:
    assert_ends_in_silence("Lift", [{}, {"backend": "stock"}])


@pytest.mark.slow
def test_external_renderers_end_without_a_word() -> None:
    assert_ends_in_silence("robosuite/Lift", [{}])


def looking(scene: Scene, looks: float | str, num_envs: int = 3) -> TaskBatch:
    batch = make_batch(
        "Lift",
        num_envs,
        scene=scene,
        seed=4,
        looks=looks,
        cameras=CameraConfig((WRIST,), 16, "lean"),
    )
    batch.begin(np.arange(num_envs))
    return batch


@pytest.mark.slow
def test_looks_change_images_and_nothing_else(lift_scene: Scene) -> None:
    plain, varied = looking(lift_scene, 0.0, 8), looking(lift_scene, 1.0, 8)
    for seed in range(2):
        before, after = (b.step(actions(b, seed)) for b in (plain, varied))
        np.testing.assert_array_equal(before.observation, after.observation)
        differs = (before.images[PART] != after.images[PART]).any(axis=(1, 2, 3))
        assert 4 <= differs.sum() < 8, "a quarter of all looks are the usual one"
    state, last = varied.save_state(), varied.observe().images[PART]
    varied.begin(np.arange(8))
    assert (varied.observe().images[PART] != last).any()
    varied.load_state(state)
    again = varied._drawn.draw(varied.engine.states, varied._looks.seeds)[PART]
    np.testing.assert_array_equal(again, last)


@pytest.mark.slow
def test_a_suite_has_three_looks_that_return(lift_scene: Scene) -> None:
    for suite in ("unseen-textures", "unseen-lights", "unseen-cameras"):
        batch = looking(lift_scene, suite, 6)
        seeds = batch._looks.seeds
        assert seeds.tolist() == [1, 2, 3, 1, 2, 3]
        rows = batch.engine.states[[0] * 6]
        images = batch._drawn.draw(rows, seeds)[PART]
        np.testing.assert_array_equal(images[:3], images[3:])
        assert all((images[i] != images[i - 1]).any() for i in range(3))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"looks": 2.0}, "a strength from 0 to 1 .*, not 2.0"),
        ({"looks": "unsen"}, "unknown looks suite 'unsen': did you mean 'unseen'"),
        ({"looks": 0.5, "cameras": None}, "looks change images only"),
        ({"looks": 0.5, "backend": "stock"}, "choose the native backend for looks 0.5"),
    ],
)
def test_looks_out_of_range_are_refused(options: dict, message: str) -> None:
    with pytest.raises(UserError, match=message):
        make_batch("Lift", **{"cameras": SMALL, **options})
