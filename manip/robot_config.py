"""RobotConfig: the arm that is simulated, and its controller."""

from typing import NamedTuple

from manip.errors import UserError, check_choice, shown

ROBOTS = ("Panda", "Sawyer", "IIWA", "Kinova3", "Jaco", "XArm7")
"""Single, fixed-base arms with seven joints that robosuite 1.5.2 ships."""
CONTROLLERS = ("OSC_POSE", "OSC_POSITION", "JOINT_POSITION")
"""robosuite's controllers whose control law the batch engine reproduces."""
CONTROL_FREQUENCIES = (10, 20, 25, 50, 100)
"""Control frequencies [Hz] at which each robosuite step gives one new observation.

At others (30, 40 Hz) robosuite's floating-point clocks drift, and some steps return
the observation of the step before.
"""


class RobotConfig(NamedTuple):
    """An arm, its controller (robosuite's names) and the control frequency [Hz]."""

    arm: str = "Panda"
    controller: str = "OSC_POSE"
    control_freq: int = 20


def check_robot_config(robot: RobotConfig) -> None:
    """Raise `UserError` unless arm, controller and control frequency are supported."""
    if not isinstance(robot, RobotConfig):
        raise UserError(
            "robot must be RobotConfig(arm, controller, control_freq), "
            f"not {shown(robot)}"
        )
    check_choice("robot", robot.arm, ROBOTS)
    check_choice("controller", robot.controller, CONTROLLERS)
    if robot.control_freq not in CONTROL_FREQUENCIES:
        raise UserError(
            f"control_freq {shown(robot.control_freq)} is not supported: choose one "
            f"of {', '.join(map(str, CONTROL_FREQUENCIES))} Hz (robosuite's clocks "
            "stay in phase only at these)"
        )
