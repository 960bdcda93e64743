"""Compare a robosuite environment that a user built with what a task assumes."""

import warnings
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from manip.errors import UserError, shown
from manip.robot_config import RobotConfig
from manip.sim.robosuite_factory import environment_class, make_stock
from manip.sim.robot_model import hand_kind, reading_prefix

Properties = Mapping[str, Any]


def check_stock(stock: Any, name: str, robot: RobotConfig, horizon: int) -> None:
    """Compare an environment with `make_stock(name, robot)`, and its time limit.

    Gains, limits of the goal and the control frequency may differ, with a warning.

    Args:
        stock: the environment.
        name: robosuite's name of the environment that is expected.
        robot: the arm, controller and control frequency that are expected.
        horizon: length of an episode [control steps] that it must allow.

    Raises:
        UserError: it differs in more; the message names each difference.
    """
    if not isinstance(stock, environment_class(name)):
        raise UserError(
            f"the robosuite environment is a {type(stock).__name__}, expected {name}"
        )
    needed, adjustable = _reference(name, robot)
    differences = _differences(_needed(stock), needed)
    if not stock.ignore_done and stock.horizon < horizon:
        differences.append(
            f"horizon is {stock.horizon}, expected at least {horizon} or ignore_done"
        )
    if differences:
        raise UserError(
            f"the robosuite environment is not {name} as make_stock builds it for "
            f"{robot}: {'; '.join(differences)}"
        )
    if harmless := _differences(_adjustable(stock), adjustable):
        warnings.warn(
            f"the robosuite environment differs from {name} as make_stock builds it: "
            f"{'; '.join(harmless)}",
            stacklevel=3,
        )


@cache
def _reference(name: str, robot: RobotConfig) -> tuple[Properties, Properties]:
    stock = make_stock(name, robot)
    return _needed(stock), _adjustable(stock)


def _needed(stock: Any) -> Properties:
    """What an action means: a difference makes a policy act wrongly."""
    return {
        "number of robots": len(stock.robots),
        **_of_each(stock, _needed_of),
        "length of an action": int(stock.action_dim),
    }


def _needed_of(robot: Any) -> Properties:
    part = _arm_controller(robot)
    return {
        "robot": robot.name,
        "gripper": hand_kind(robot),
        "controller": getattr(part, "name", None),
        "controller input_type": getattr(part, "input_type", None),
        "controller input_ref_frame": getattr(part, "input_ref_frame", None),
        "controller impedance_mode": getattr(part, "impedance_mode", None),
        "controller input_min": _plain(part, "input_min"),
        "controller input_max": _plain(part, "input_max"),
        "controller output_min": _plain(part, "output_min"),
        "controller output_max": _plain(part, "output_max"),
    }


def _adjustable(stock: Any) -> Properties:
    """How the arm follows: a policy may cope with a difference."""
    return {"control_freq": stock.control_freq, **_of_each(stock, _adjustable_of)}


def _adjustable_of(robot: Any) -> Properties:
    part = _arm_controller(robot)
    names = ("kp", "kd", "position_limits", "orientation_limits", "uncoupling")
    return {f"controller {name}": _plain(part, name) for name in names}


def _of_each(stock: Any, read: Callable[[Any], Properties]) -> Properties:
    """Properties of all robots; names of a second one's begin as its readings' do."""
    return {
        f"{reading_prefix(number)}{name}": value
        for number, robot in enumerate(stock.robots)
        for name, value in read(robot).items()
    }


def _arm_controller(robot: Any) -> Any:
    return robot.part_controllers.get("right")


def _plain(part: Any, name: str) -> Any:
    """An attribute to compare: arrays as lists, one number where all are equal."""
    value = getattr(part, name, None)
    if value is None or isinstance(value, bool):
        return value
    numbers = np.round(np.ravel(value), 6).tolist()
    return numbers[0] if len(set(numbers)) == 1 else numbers


def _differences(ours: Properties, expected: Properties) -> list[str]:
    return [
        f"{name} is {shown(ours.get(name))}, expected {shown(expected[name])}"
        for name in expected
        if ours.get(name) != expected[name]
    ]
