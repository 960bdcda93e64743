"""Contacts that a task reads: pairs of sides, each a set of geoms or a body."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from manip.sim.names import find, lookup
from manip.sim.robot_model import hand_kind, reading_prefix

_PADS = {
    "XArm7Gripper": {
        f"{side}_fingerpad": [f"{side}_finger_pad_{i}" for i in (1, 2)]
        for side in ("left", "right")
    }
}
"""Finger pads by their real names in the hand, where robosuite 1.5.2 names geoms that
its model lacks (models/grippers/xarm7_gripper.py); its own grasp test never fires."""


class Side(NamedTuple):
    """One side of a contact: geoms by name, or a body with all bodies below it."""

    geoms: tuple[str, ...]
    body: str | None


class Touch(NamedTuple):
    """A named number of contacts between two sides, at most `limit`; 1 for a flag."""

    name: str
    first: Side
    second: Side
    limit: float


def read_touches(
    stock: Any, named: Mapping[str, tuple[str, str]], limit: float
) -> Iterator[Touch]:
    """Find the touches that a task names in a robosuite environment."""
    for name, (first, second) in named.items():
        yield Touch(name, _side(stock, first), _side(stock, second), limit)


def _side(stock: Any, name: str) -> Side:
    groups = _robot_groups(stock)
    if name in groups:
        return Side(tuple(groups[name]), None)
    model = stock.sim.model._model
    if find(model, "body", name) < 0 <= find(model, "geom", name):
        return Side((name,), None)
    lookup(model, "body", name)
    return Side((), name)


def _robot_groups(stock: Any) -> dict[str, list[str]]:
    """Group -> geoms of the robots: those of the hands, and the links of the arms.

    Names of a second robot's groups begin as those of its readings.
    """
    named: dict[str, list[str]] = {}
    for number, robot in enumerate(stock.robots):
        hand, pads = robot.gripper["right"], _PADS.get(hand_kind(robot), {})
        groups = hand.important_geoms | hand.correct_naming(pads)
        groups["arm"] = robot.robot_model.contact_geoms
        prefix = reading_prefix(number)
        named |= {prefix + group: geoms for group, geoms in groups.items()}
    return named
