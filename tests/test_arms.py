"""Each arm lifts the cube, and its hand is what the readings say."""

import mujoco
import numpy as np
import pytest

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Task
from manip.robot_config import ROBOTS, RobotConfig
from manip.sim.batch_engine import BatchEngine
from manip.sim.robot_model import WIDE
from manip.sim.scene import Fidelity, Scene, load_scene

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


def test_only_hands_whose_yaw_matters_observe_their_turn(
    robot: str, lift: Task, scene: Scene
) -> None:
    observation = lift.observe(lift.measure(BatchEngine(scene, 2).read()))
    assert ("turn" in observation) == (robot in {"Kinova3", "Jaco", "Sawyer"})


def test_a_hand_opens_and_shuts_to_the_widths_that_are_read(scene: Scene) -> None:
    read = BatchEngine(scene, 1).read()
    (shut,), (opened,) = read["gripper_narrowest"], read["gripper_widest"]
    assert shut - 0.003 <= gap(scene, 1.0) <= max(shut + 0.005, 0.02)
    assert opened - 0.002 <= gap(scene, -1.0)
    assert gap(scene, -1.0) < opened + 0.003 or opened == WIDE


def gap(scene: Scene, closing: float) -> float:
    """Gap [m] between the pads of the hand in the air, a second after it is commanded.

    closing: 1 to shut, -1 to open.
    """
    model, layout = scene.visual, scene.layout
    data, (arm, gripper) = mujoco.MjData(model), layout.robots[0]
    data.qpos[:] = layout.qpos
    command = closing * np.sign(gripper.speed)
    for _ in range(500):
        data.ctrl[gripper.actuator] = gripper.bias + gripper.weight * command
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


@pytest.mark.parametrize("fidelity", ["exact", "fast"])
def test_friction_on_its_base_holds_the_sawyers_first_joint(
    fidelity: Fidelity, lift: Task
) -> None:
    """As in stock robosuite, also where the other contacts of the arm are left out."""
    scene = load_scene("Lift", lift.sensors, RobotConfig("Sawyer"), fidelity)
    engine = BatchEngine(scene, 1, threads=1)
    before = engine.read()["joint_pos"].copy()
    for _ in range(10):
        engine.step(np.array([[0, -1, 0, 0, 0, 0, 0]]))
    moved = np.abs(engine.read()["joint_pos"] - before)[0]
    assert moved[0] < 1e-3
    assert moved[1:].max() > 0.1
