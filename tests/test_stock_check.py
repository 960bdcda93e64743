"""A robosuite environment that is handed in is compared with what a task assumes."""

import threading
import warnings

import numpy as np
import pytest
import robosuite

from manip.envs.backends.stock_batch import StockBatch
from manip.envs.task import Task
from manip.errors import UserError
from manip.robot_config import RobotConfig
from manip.sim.robosuite_factory import make_stock


def changed_controller(**changes: object) -> dict:
    config = robosuite.load_composite_controller_config(robot="Panda")
    config["body_parts"]["right"] |= changes
    return config


def built(name: str = "Lift", robot: str = "Panda", **options) -> object:
    settings = {
        "has_renderer": False,
        "has_offscreen_renderer": False,
        "use_camera_obs": False,
        "ignore_done": True,
    }
    return robosuite.make(name, robots=robot, **(settings | options))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"robot": "Sawyer"}, "robot is 'Sawyer', expected 'Panda'; gripper is"),
        ({"name": "Stack"}, "environment is a Stack, expected Lift"),
        pytest.param(
            {"gripper_types": "Robotiq85Gripper"},
            "gripper is 'Robotiq85Gripper', expected 'PandaGripper'",
            marks=pytest.mark.slow,
        ),
        (
            {"controller_configs": changed_controller(input_type="absolute")},
            "controller input_type is 'absolute', expected 'delta'",
        ),
        pytest.param(
            {"controller_configs": changed_controller(input_ref_frame="world")},
            "controller input_ref_frame is 'world', expected 'base'",
            marks=pytest.mark.slow,
        ),
        (
            {"controller_configs": changed_controller(output_max=[0.1] * 6)},
            "controller output_max is 0.1, expected .*0.05",
        ),
        (
            {"controller_configs": changed_controller(type="JOINT_POSITION")},
            "controller is 'JOINT_POSITION', expected 'OSC_POSE'",
        ),
        ({"horizon": 50, "ignore_done": False}, "horizon is 50, expected at least"),
        pytest.param(
            {"controller_configs": changed_controller(impedance_mode="variable")},
            "impedance_mode is 'variable', expected 'fixed'",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_each_difference_is_named_in_one_line(
    options: dict, text: str, lift: Task
) -> None:
    with pytest.raises(UserError, match=text) as error:
        StockBatch(lift, stock=built(**options))
    assert "\n" not in str(error.value)


def test_what_the_robot_config_assumes_is_compared(lift: Task) -> None:
    stock = make_stock("Lift", RobotConfig(controller="JOINT_POSITION"))
    StockBatch(lift, stock=stock, robot=RobotConfig(controller="JOINT_POSITION"))
    with pytest.raises(UserError, match="controller is 'JOINT_POSITION'"):
        StockBatch(lift, stock=stock)


@pytest.mark.parametrize("stock", ["Lift", 7])
def test_something_else_than_an_environment_is_refused(stock, lift: Task) -> None:
    with pytest.raises(UserError, match="expected Lift"):
        StockBatch(lift, stock=stock)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"control_freq": 10}, "control_freq is 10, expected 20"),
        ({"controller_configs": changed_controller(kp=90)}, "kp is 90.0, expected 150"),
    ],
)
def test_gains_and_frequency_may_differ_with_a_warning(
    options: dict, text: str, lift: Task
) -> None:
    with pytest.warns(UserWarning, match=text):
        StockBatch(lift, stock=built(**options))


def test_the_assumed_environment_gives_no_warning(lift: Task) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        StockBatch(lift, stock=built())
        StockBatch(lift, stock=built(horizon=lift.horizon, ignore_done=False))


def test_a_second_thread_is_refused(lift: Task) -> None:
    batch, errors = StockBatch(lift), []
    batch.begin(np.arange(1))
    begin = threading.Barrier(3)

    def use() -> None:
        begin.wait()
        try:
            for _ in range(20):
                batch.step(np.zeros((1, batch.action_dim)))
        except UserError as error:
            errors.append(str(error))

    users = [threading.Thread(target=use) for _ in range(3)]
    for user in users:
        user.start()
    for user in users:
        user.join()
    assert errors
    assert all("in use by another thread" in error for error in errors)
