"""The robots' part of every task of two robots: measures, observation, actions.

Readings, touches and measures of the second robot have the names of the first one's,
after `robot1_`. robosuite's robots stand opposite each other and face the middle, the
first one on the side of negative y.
"""

from collections.abc import Callable

import numpy as np

from manip.envs.task import Measures
from manip.sim.robot_model import reading_prefix
from manip.tasks.arm import ARM_PARTS, TOOL_PARTS, observe_arm_and_tool

Array = np.ndarray

ROBOTS = (0, 1)

ROBOT_PARTS = tuple(
    f"{reading_prefix(number)}{part}"
    for number in ROBOTS
    for part in (*ARM_PARTS, *TOOL_PARTS)
)
"""Parts of `observe_robots`, all of which real arms measure themselves."""


def of_robot(m: Measures, number: int) -> Measures:
    """The measures, with a robot's own under the names that the first robot's have."""
    prefix = reading_prefix(number)
    own = {n.removeprefix(prefix): v for n, v in m.items() if n.startswith(prefix)}
    return {**m, **own}


def measure_robots(
    read: Measures, measure: Callable[[Measures, int], Measures]
) -> Measures:
    """Add what `measure(of_robot(read, number), number)` returns for each robot."""
    added = {
        f"{reading_prefix(number)}{name}": value
        for number in ROBOTS
        for name, value in measure(of_robot(read, number), number).items()
    }
    return {**read, **added}


def observe_robots(m: Measures, centre: Array) -> dict[str, Array]:
    """For each robot as `observe_arm_and_tool`."""
    return {
        f"{reading_prefix(number)}{name}": part
        for number in ROBOTS
        for name, part in observe_arm_and_tool(of_robot(m, number), centre).items()
    }


def joint_action(*actions: Array) -> Array:
    """[n, A]: the actions of both robots, from OSC_POSE actions in the world frame."""
    return np.hstack([_in_base(action, k) for k, action in enumerate(actions)])


def _in_base(action: Array, number: int) -> Array:
    """Turn an action's motion and rotation into the frame of a robot's base, which is
    turned by 90 degrees, or by -90.
    """
    sign, turned = (1 - 2 * number), action.copy()
    for first in (0, 3):
        turned[:, first] = sign * action[:, first + 1]
        turned[:, first + 1] = -sign * action[:, first]
    return turned
