"""Which arm is simulated, and how it is controlled."""

from typing import NamedTuple

from manip.errors import UserError, check_choice

ROBOTS = ("Panda", "Sawyer", "IIWA", "Kinova3", "Jaco", "XArm7")
"""Single, fixed-base arms with seven joints that robosuite 1.5.2 ships."""
CONTROLLERS = ("OSC_POSE", "OSC_POSITION", "JOINT_POSITION")
"""Action spaces whose control law the batch engine reproduces."""
CONTROL_FREQUENCIES = (10, 20, 25, 50, 100)
"""Frequencies [Hz] at which stock observations fire once per step, in phase.

At others (30, 40 Hz) robosuite's floating-point clocks drift and some steps return
no new observation.
"""


class RobotConfig(NamedTuple):
    """An arm and how it is driven: `control_freq` in Hz, the rest as robosuite says."""

    arm: str = "Panda"
    controller: str = "OSC_POSE"
    control_freq: int = 20


def check_robot_config(robot: RobotConfig) -> None:
    """Raise `UserError` for a robot, controller or control frequency that is not."""
    check_choice("robot", robot.arm, ROBOTS)
    check_choice("controller", robot.controller, CONTROLLERS)
    if robot.control_freq not in CONTROL_FREQUENCIES:
        raise UserError(
            f"control frequency {robot.control_freq} Hz is not possible: robosuite keeps "
            f"its clocks in phase only at {', '.join(map(str, CONTROL_FREQUENCIES))} Hz"
        )
