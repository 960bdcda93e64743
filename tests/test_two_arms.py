"""Tasks of two robots: what each robot reads and does, rewards, what is refused."""

import numpy as np
import pytest

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.interface import Interface, interface_of
from manip.envs.perturbation import Perturbation
from manip.envs.task import Measures, Task
from manip.errors import UserError
from manip.rewards.compose import weighted_sum
from manip.sim.batch_engine import BatchEngine
from manip.sim.inverse_kinematics import InverseKinematics
from manip.sim.robot_motion import RobotMotion
from manip.sim.scene import Scene
from manip.tasks.two_arm_lift import HALF, TABLE, TwoArmLift
from manip.tasks.two_arm_peg_in_hole import TwoArmPegInHole
from manip.tasks.two_arms import of_robot

Array = np.ndarray

OWN = ("joint_pos", "eef_pos", "gripper_qpos", "gripper_closing")


@pytest.fixture(scope="module")
def lift_scene(scene_of) -> Scene:
    return scene_of(TwoArmLift())


@pytest.fixture(scope="module")
def peg_scene(scene_of) -> Scene:
    return scene_of(TwoArmPegInHole())


def test_an_action_holds_the_robots_numbers_in_turn(
    lift_scene: Scene, peg_scene: Scene
) -> None:
    assert (lift_scene.layout.action_dim, peg_scene.layout.action_dim) == (14, 12)


@pytest.mark.parametrize("number", [0, 1])
def test_a_robots_numbers_move_that_robot_alone(number: int, lift_scene: Scene) -> None:
    engine = BatchEngine(lift_scene, 2, threads=1)
    action = np.zeros((2, 2, 7))
    action[0, number] = 1.0
    for _ in range(2):
        engine.step(action.reshape(2, 14))
    for name in OWN:
        moved, other = (of_robot(engine.read(), k)[name] for k in (number, 1 - number))
        assert np.abs(moved[0] - moved[1]).max() > 1e-3, name
        np.testing.assert_allclose(other[0], other[1], atol=1e-5, err_msg=name)


def test_a_state_set_holds_for_both_robots(lift_scene: Scene) -> None:
    engine = BatchEngine(lift_scene, 2, threads=1)
    engine.step(np.linspace(-1, 1, 28).reshape(2, 14))
    read = {name: values.copy() for name, values in engine.read().items()}
    hidden = {name: read[name][:1] for name in ("start_pos", "gripper_command")}
    engine.set_state(np.array([1]), read["qpos"][:1], read["qvel"][:1], **hidden)
    for name in ("joint_pos", "gripper_closing", *hidden):
        for k in (0, 1):
            now = of_robot(engine.read(), k)[name]
            np.testing.assert_array_equal(now[1], now[0], err_msg=name)


def test_motion_is_that_of_both_robots(lift_scene: Scene) -> None:
    batch = NativeBatch(TwoArmLift(), 2, scene=lift_scene, threads=1, motion=True)
    batch.begin(np.arange(2))
    action = np.zeros((2, 14))
    action[:, 7:9] = 1.0
    batch.step(action)
    motion = batch.motion()
    assert {motion[name].shape for name in ("joint_vel", "peak_speed")} == {(2, 14)}
    first, second = np.split(motion["peak_speed"], 2, axis=1)
    assert second.max() > 3 * first.max()


def test_self_contact_is_of_one_robot_alone(lift_scene: Scene) -> None:
    geoms = RobotMotion(lift_scene)._geoms
    assert all(hand.any() and (robot & ~hand).any() for hand, robot in geoms)
    assert not (geoms[0][1] & geoms[1][1]).any()


# Rewards


def pot(height: list[float], turn: list[float], closing: float = 1.0) -> Measures:
    """Both tools grasp at their handles; the pot at heights [m], tilted [rad]."""
    n, half = len(height), np.array(turn) / 2
    centre = np.outer(np.array(height) + HALF + TABLE[2], [0, 0, 1])
    quat = np.column_stack([np.cos(half), np.sin(half), 0 * half, 0 * half])
    touches = dict.fromkeys(TwoArmLift.sensors.touches, np.ones(n))
    named = {"pot_pos": centre, "pot_quat": quat, "handle0_pos": centre}
    named |= {"handle1_pos": centre, "eef_pos": centre, "robot1_eef_pos": centre}
    closings = ("gripper_closing", "robot1_gripper_closing")
    return {**named, **touches, **dict.fromkeys(closings, np.full(n, closing))}


def paid(task: Task, read: Measures, reward: str) -> Array:
    terms = task.reward_terms(task.measure(read), reward)
    return weighted_sum(terms, task.weights[reward])


def test_the_pots_lift_pays_as_documented() -> None:
    read = pot([0.0, 0.03, 0.12, 0.12, 0.12], [0.0, 0.1, 0.1, 0.3, 0.5])
    expected = [0.5, 0.625, 1.0, 0.75, 0.5]
    np.testing.assert_allclose(paid(TwoArmLift(), read, "shaped"), expected)


def test_each_robot_has_half_of_reach_and_grasp() -> None:
    read = pot([0.0], [0.0])
    read["robot1_eef_pos"] = read["robot1_eef_pos"] + [0.2, 0.0, 0.0]
    read |= {f"robot1_left_touch_{bar}": np.zeros(1) for bar in "c-+"}
    far = 0.1 + 0.1 * (1 - np.tanh(1.0)) + 0.15
    np.testing.assert_allclose(paid(TwoArmLift(), read, "shaped"), [far])


def test_the_pots_stock_reward_is_robosuites() -> None:
    read = pot([0.0, 0.08, 0.08, 0.11, 0.11], [0.0, 0.0, 0.6, 0.5, 0.6])
    expected = [0.5, 0.6, 0.5, 1.0, 0.0]
    np.testing.assert_allclose(paid(TwoArmLift(), read, "stock"), expected)


# What is refused


def test_features_of_one_robot_are_refused_at_once(lift_scene: Scene) -> None:
    with pytest.raises(UserError, match="inverse kinematics does not support 2 robots"):
        InverseKinematics(lift_scene)


def test_a_card_has_no_interface_of_two_robots(lift_scene: Scene) -> None:
    batch = NativeBatch(TwoArmLift(), 1, scene=lift_scene, threads=1)
    assert interface_of(batch, batch.observation_spec.names) == Interface()


# Perturbations


def test_both_robots_are_perturbed(lift_scene: Scene) -> None:
    noise = Perturbation("joint_position", normal=0.1, per="step")
    batch = NativeBatch(
        TwoArmLift(), 64, scene=lift_scene, threads=1, perturbations=(noise,)
    )
    batch.begin(np.arange(64))
    parts = batch.observation_spec.split(batch.observe().observation)
    for k in (0, 1):
        true = of_robot(batch.task.observe(batch._cache.get()), k)["joint_pos"]
        assert np.std(of_robot(parts, k)["joint_pos"] - true) == pytest.approx(0.1, 0.2)
