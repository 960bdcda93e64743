"""Read a stock robosuite environment under the names that the batch engine gives."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from manip.sim.fields import read_slot
from manip.sim.names import lookup
from manip.sim.read_only import read_only
from manip.sim.scene_layout import (
    SceneLayout,
    constant_readings,
    read_scene_layout,
    with_joints,
)
from manip.sim.sensors import Sensors
from manip.sim.slots import force_slots
from manip.sim.touches import Side

Array = np.ndarray


def stock_reader(stock: Any, sensors: Sensors) -> Callable[[], dict[str, Array]]:
    """Build a function that reads a stock environment as `RowEngine.read` does.

    Returns:
        A function that returns the same names, with read-only arrays [1, k]. A hard
        reset gives the environment a new simulation: build another reader then.
    """
    layout = read_scene_layout(stock, sensors)
    model, data = stock.sim.model._model, stock.sim.data._data
    touches = layout.touches
    slots = (*layout.slots, *force_slots(model, sensors.forces))
    sides = [(_geom_ids(model, t.first), _geom_ids(model, t.second)) for t in touches]
    constants = constant_readings(layout)

    def read() -> dict[str, Array]:
        named = {slot.name: read_slot(data, slot)[None] for slot in slots}
        for slot in layout.fields:
            named[slot.name] = read_slot(model, slot)[None]
        for touch, pair in zip(touches, sides, strict=True):
            contacts = float(_contacts(data, *pair))
            named[touch.name] = np.array([min(contacts, touch.limit)])
        named["gripper_command"] = np.concatenate(_commands(stock, layout))[None]
        parts = [robot.part_controllers["right"] for robot in stock.robots]
        starts = [part.initial_joint for part in parts]
        named["start_pos"] = np.concatenate(starts)[None]
        return read_only(with_joints(layout, {**named, **constants}))

    return read


def _commands(stock: Any, layout: SceneLayout) -> list[Array]:
    """Of each gripper, one number an actuator; robosuite may have one for all."""
    hands = [robot.gripper["right"] for robot in stock.robots]
    return [
        np.broadcast_to(hand.current_action, robot.gripper.speed.shape)
        for hand, robot in zip(hands, layout.robots, strict=True)
    ]


def _contacts(data: mujoco.MjData, first: Array, second: Array) -> int:
    a, b = data.contact.geom.T
    forward = np.isin(a, first) & np.isin(b, second)
    backward = np.isin(b, first) & np.isin(a, second)
    return int((forward | backward).sum())


def _geom_ids(model: mujoco.MjModel, side: Side) -> Array:
    if side.geoms:
        return np.array([lookup(model, "geom", name) for name in side.geoms])
    root = lookup(model, "body", side.body or "")
    inside = [root]
    for body in range(root + 1, model.nbody):
        if model.body_parentid[body] in inside:
            inside.append(body)
    return np.flatnonzero(np.isin(model.geom_bodyid, inside))
