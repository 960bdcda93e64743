"""Cameras through Gymnasium, dm_env, and the environments of other libraries."""

import os
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import manip.envs.adapters.gymnasium  # noqa: F401
from manip.cameras import CameraConfig
from manip.envs import make_batch
from manip.envs.adapters.dm_env import TaskEnvironment
from manip.errors import UserError
from manip.sim import gl

pytestmark = pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)

PART = "robot0_eye_in_hand_image"
WRIST = {"cameras": ["robot0_eye_in_hand"], "image_size": 16, "image_quality": "lean"}


@pytest.mark.slow
def test_gymnasium_gives_numbers_by_role_and_pictures() -> None:
    options = {"max_episode_steps": 3, "frames": 2, **WRIST}
    envs = gymnasium.make_vec("manip/Reach-v0", num_envs=2, **options)
    space = envs.single_observation_space
    first, _ = envs.reset(seed=0)
    assert space[PART] == gymnasium.spaces.Box(0, 255, (16, 16, 6), np.uint8)
    assert {*space} == {"proprioception", "object", PART}
    for _ in range(3):
        last, _, _, truncated, info = envs.step(np.ones((2, 7), np.float32))
    assert truncated.all()
    for env_id, final in enumerate(info["final_obs"]):
        assert space.contains(final)
        assert (final[PART] != last[PART][env_id]).any()
    joined = np.concatenate([first["proprioception"], first["object"]], axis=1)
    assert joined.shape == (2, envs.batch.observation_spec.dim)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*A Box observation space")
def test_gymnasiums_checker_passes_with_cameras() -> None:
    env = gymnasium.make("manip/Reach-v0", **WRIST)
    check_env(env.unwrapped, skip_render_check=True)


def test_mistakes_in_cameras_are_errors() -> None:
    with pytest.raises(UserError, match="unknown image quality 'best'"):
        gymnasium.make("manip/Reach-v0", **WRIST | {"image_quality": "best"})


def test_dm_env_gives_pictures_as_parts() -> None:
    cameras = CameraConfig(("robot0_eye_in_hand",), 16, "lean")
    env = TaskEnvironment("Reach", cameras=cameras)
    observation = env.reset().observation
    assert list(env.observation_spec()) == list(observation)
    for name, spec in env.observation_spec().items():
        spec.validate(observation[name])


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
def test_robosuites_other_environments_observe_cameras(threads: int) -> None:
    cameras = CameraConfig(("robot1_eye_in_hand",), 16, frames=2)
    batch = make_batch("robosuite/TwoArmLift", 2, cameras=cameras, threads=threads)
    batch.begin(np.arange(2))
    first = batch.observe().images["robot1_eye_in_hand_image"]
    last = batch.step(np.ones((2, batch.action_dim)))
    state, names = batch.save_state(), batch.observation_spec.names
    assert names[-1:] == ("robot1_eye_in_hand_image",)
    assert not any("image" in name for name in names[:-1])
    images = last.images["robot1_eye_in_hand_image"]
    np.testing.assert_array_equal(images[..., :3], first[..., 3:])
    batch.begin(np.arange(2))
    batch.load_state(state)
    again = batch.observe().images["robot1_eye_in_hand_image"]
    np.testing.assert_array_equal(again, images)


DM_CONTROL = """
import numpy as np
from dm_control import manipulation
from manip.cameras import CameraConfig
from manip.envs import RobotConfig, make_batch
batch = make_batch(
    "dm_control/reach_site_features", 1, threads=1,
    robot=RobotConfig("Jaco", "JOINT_VELOCITY", 25),
    cameras=CameraConfig(("front_close",), 48),
)
for step in range(6):
    if step % 3 == 0:
        batch.begin(np.array([0]))
        images = batch.observe().images
    else:
        images = batch.step(np.full((1, 9), 0.3)).images
    physics = batch._pool._local[0]._env.physics
    theirs = physics.render(48, 48, "front_close")[::-1]
    assert (images["front_close_image"][0] == theirs).all(), step
"""


@pytest.mark.slow
def test_dm_controls_pictures_are_its_own() -> None:
    backend = gl.find_backend() or ""
    variables = {"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
    done = subprocess.run(
        [sys.executable, "-c", DM_CONTROL],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_an_unknown_camera_of_another_library_is_an_error() -> None:
    with pytest.raises(UserError, match="unknown camera 'agentvew': did you mean"):
        make_batch("robosuite/Lift", cameras=CameraConfig(("agentvew",)))
