"""Each arm lifts the cube, and its hand is what the readings say."""

import mujoco
import numpy as np
import pytest

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Task
from manip.robot_config import ROBOTS, RobotConfig
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import Scene, load_scene

Array = np.ndarray

NUM_ENVS = 4
LAST_STEPS = 10
IN_DEFAULT_SUITE = {"Kinova3", "Jaco"}
"""Arms whose hands grasp in another way than the Panda's, which all tests use."""

ARMS = [
    name if name in IN_DEFAULT_SUITE else pytest.param(name, marks=pytest.mark.slow)
    for name in ROBOTS
]


@pytest.fixture(scope="module", params=ARMS)
def robot(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def scene(robot: str, lift: Task) -> Scene:
    return load_scene("Lift", lift.sensors, RobotConfig(robot))


@pytest.mark.slow
def test_the_expert_lifts_the_cube_and_keeps_it(lift: Task, scene: Scene) -> None:
    engine, env_ids = BatchEngine(scene, NUM_ENVS, threads=2), np.arange(NUM_ENVS)
    engine.reset(
        env_ids, *lift.sample_start(scene, EpisodeStreams(0, env_ids, env_ids))
    )
    success = []
    for _ in range(lift.horizon):
        engine.step(lift.expert(lift.measure(engine.read())))
        success.append(lift.success(lift.measure(engine.read())))
    assert engine.broken_count == 0
    assert np.array(success[-LAST_STEPS:]).all()


def test_only_clumsy_hands_observe_their_turn(
    robot: str, lift: Task, scene: Scene
) -> None:
    observation = lift.observe(lift.measure(BatchEngine(scene, 2).read()))
    assert ("turn" in observation) == (robot in IN_DEFAULT_SUITE)


def test_a_hand_shuts_to_the_width_that_is_read(lift: Task, scene: Scene) -> None:
    read = BatchEngine(scene, 1).read()
    (width,) = read["gripper_narrowest"]
    assert width - 0.003 <= shut(scene) <= max(width + 0.005, 0.02)


def shut(scene: Scene) -> float:
    """Gap [m] between the pads of the hand in the air, half a second after it shut."""
    model, layout = scene.visual, scene.layout
    data, (arm, gripper) = mujoco.MjData(model), layout.robots[0]
    data.qpos[:] = layout.qpos
    for _ in range(500):
        data.ctrl[gripper.actuator] = gripper.bias + gripper.weight * np.sign(
            gripper.speed
        )
        data.qpos[arm.qpos], data.qvel[arm.dof] = layout.qpos[arm.qpos], 0.0
        mujoco.mj_step(model, data)
    first, second = (
        [model.geom(name).id for name in touch.first.geoms] for touch in layout.touches
    )
    segment = np.zeros(6)
    return min(
        mujoco.mj_geomDistance(model, data, a, b, 1.0, segment)
        for a in first
        for b in second
    )
