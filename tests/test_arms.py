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

WORLDS = 4
HELD_STEPS = 10
EVERY_DAY = {"Kinova3", "Jaco"}
"""Arms whose hands take the cube another way than the Panda's, which all tests use."""

ARMS = [
    name if name in EVERY_DAY else pytest.param(name, marks=pytest.mark.slow)
    for name in ROBOTS
]


@pytest.fixture(scope="module", params=ARMS)
def robot(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def scene(robot: str, lift: Task) -> Scene:
    return load_scene("Lift", lift.sensors, RobotConfig(robot))


def test_the_script_lifts_the_cube_and_keeps_it(lift: Task, scene: Scene) -> None:
    engine, worlds = BatchEngine(scene, WORLDS, threads=2), np.arange(WORLDS)
    engine.reset(worlds, *lift.sample_start(scene, EpisodeStreams(0, worlds, worlds)))
    held = []
    for _ in range(lift.horizon):
        engine.step(lift.expert(lift.measure(engine.read())))
        held.append(lift.success(lift.measure(engine.read())))
    assert engine.broken_count == 0
    assert np.array(held[-HELD_STEPS:]).all()


def test_only_clumsy_hands_see_their_turn(robot: str, lift: Task, scene: Scene) -> None:
    seen = lift.observe(lift.measure(BatchEngine(scene, 2).read()))
    assert ("turn" in seen) == (robot in EVERY_DAY)


def test_a_hand_shuts_to_the_width_that_is_read(lift: Task, scene: Scene) -> None:
    read = BatchEngine(scene, 1).read()
    (width,) = read["gripper_narrowest"]
    assert width - 0.003 <= shut(scene) <= max(width + 0.005, 0.02)


def shut(scene: Scene) -> float:
    """Gap [m] between the pads of the hand in the air, half a second after it shut."""
    model, handles = scene.visual, scene.layout
    data, gripper, arm = mujoco.MjData(model), handles.gripper, handles.arm
    data.qpos[:] = handles.qpos
    for _ in range(500):
        data.ctrl[gripper.actuator] = gripper.bias + gripper.weight * np.sign(
            gripper.speed
        )
        data.qpos[arm.qpos], data.qvel[arm.dof] = handles.qpos[arm.qpos], 0.0
        mujoco.mj_step(model, data)
    first, second = (
        [model.geom(name).id for name in touch.first.geoms] for touch in handles.touches
    )
    segment = np.zeros(6)
    return min(
        mujoco.mj_geomDistance(model, data, a, b, 1.0, segment)
        for a in first
        for b in second
    )
