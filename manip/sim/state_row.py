"""Layout of the rows in which the batch engine stores states and readings."""

from collections.abc import Iterator

import numpy as np

from manip.sim.fields import read_slot
from manip.sim.scene import GAINS, Scene
from manip.sim.slots import Slot

Array = np.ndarray

PEAKS = ("peak_speed", "peak_torque")
"""Readings of the arms' joints over the last control period; see `Scene.with_peaks`."""


def state_columns(scene: Scene) -> dict[str, slice]:
    """Part -> columns of a state row, in order: all that a step depends on.

    qpos [nq], qvel [nv], warmstart [nv] (the constraint solver's start, qacc of the
    step before), start_pos (the arms' joints at the start of the episode),
    gripper_command, the model fields, the varied entries, the task's memory.
    """
    columns, start = {}, 0
    for name, size in _parts(scene):
        columns[name] = slice(start, start + size)
        start += size
    return columns


def default_row(scene: Scene) -> Array:
    """The state row [S] of the model: default pose and fields, everything else 0.

    Fields have their compiled values. The stock model, which robosuite changes when it
    resets, is read for those that the physics model lacks.
    """
    columns, layout = state_columns(scene), scene.layout
    row = np.zeros(max(part.stop for part in columns.values()))
    row[columns["qpos"]] = layout.qpos
    row[columns["start_pos"]] = layout.qpos[layout.joint_qpos]
    for drawn, stepped in zip(layout.fields, scene.physics_fields, strict=True):
        owner, slot = (scene.physics, stepped) if stepped else (scene.visual, drawn)
        row[columns[drawn.name]] = read_slot(owner, slot)
    for slot in scene.varied:
        row[columns[slot.name]] = varied_default(scene, slot)
    return row


def varied_default(scene: Scene, slot: Slot) -> Array:
    """[size]: the compiled values of varied entries."""
    if slot.array == GAINS:
        arm = scene.layout.robots[0].arm
        return np.array([arm.kp, arm.kd])
    return read_slot(scene.physics, slot)


def reading_columns(scene: Scene) -> dict[str, slice | int]:
    """Reading -> columns of a readings row: the slots, then one number a touch."""
    columns: dict[str, slice | int] = {}
    start = 0
    for slot in scene.layout.slots:
        columns[slot.name] = slice(start, start + slot.size)
        start += slot.size
    if scene.with_peaks:
        joints = len(scene.layout.joint_qpos)
        for name in PEAKS:
            columns[name] = slice(start, start + joints)
            start += joints
    for index, touch in enumerate(scene.layout.touches):
        columns[touch.name] = start + index
    return columns


def readings_width(scene: Scene) -> int:
    """Length of a readings row."""
    return touch_start(scene) + len(scene.layout.touches)


def touch_start(scene: Scene) -> int:
    """Column of the first touch in a readings row."""
    peaks = len(PEAKS) * len(scene.layout.joint_qpos) if scene.with_peaks else 0
    return sum(slot.size for slot in scene.layout.slots) + peaks


def _parts(scene: Scene) -> Iterator[tuple[str, int]]:
    model, layout = scene.physics, scene.layout
    yield "qpos", model.nq
    yield "qvel", model.nv
    yield "warmstart", model.nv
    yield "start_pos", len(layout.joint_qpos)
    yield "gripper_command", sum(len(each.gripper.actuator) for each in layout.robots)
    yield from ((slot.name, slot.size) for slot in (*layout.fields, *scene.varied))
    yield from layout.memory.items()
