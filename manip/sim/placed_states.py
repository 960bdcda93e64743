"""Properties of scenes and states that objects are placed in by computation."""

import copy
from collections.abc import Iterator, Mapping
from dataclasses import replace

import mujoco
import numpy as np

from manip.sim.batch_engine import BatchEngine
from manip.sim.fields import write_slot
from manip.sim.scene import Scene
from manip.sim.slots import Slot

Array = np.ndarray

OPENING_STEPS = 40
"""Control steps after which every gripper is open."""

DAMPING = np.repeat([3.0, 0.002], 3)
"""Damping of a free object's translation [N s/m] and rotation [N m s/rad] without
gravity. A cube of 70 g that one finger pushes at 0.1 m/s stops after 3 mm, before the
other finger touches it."""


def weightless(scene: Scene) -> Scene:
    """The scene without gravity, its free objects damped (`DAMPING`).

    What a hand closes around stays where it is until it is gripped.
    """
    physics = copy.copy(scene.physics)
    physics.opt.gravity[:] = 0.0
    for dof in physics.jnt_dofadr[physics.jnt_type == mujoco.mjtJoint.mjJNT_FREE]:
        physics.dof_damping[dof : dof + 6] = DAMPING
    return replace(scene, physics=physics)


def open_gripper(scene: Scene) -> tuple[Array, Array]:
    """Positions [k] of the finger joints, and commands [m], of the open gripper.

    It opens on the engine, in the arm's default pose.
    """
    engine, layout = BatchEngine(scene, 1, threads=1), scene.layout
    action = np.zeros((1, layout.action_dim))
    action[:, -1] = -1.0
    for _ in range(OPENING_STEPS):
        engine.step(action)
    read = engine.read()
    return read["gripper_qpos"][0].copy(), read["gripper_command"][0].copy()


def penetration(scene: Scene, qpos: Array, fields: Mapping[str, Array]) -> Array:
    """[n] m: the deepest penetration in poses qpos [n, nq]; 0 where nothing touches.

    Contacts of parked bodies do not count, nor those of a gripper's links with each
    other: in some of robosuite's grippers, open or shut, they overlap by millimetres.

    Args:
        scene: whose geoms collide.
        qpos: of n environments.
        fields: name -> [n, k], model fields of these environments.
    """
    model = copy.copy(scene.physics)
    data, deepest = mujoco.MjData(model), np.zeros(len(qpos))
    away, fingers = scene.parked_geoms, _finger_geoms(scene)
    for row, pose in enumerate(qpos):
        for slot, values in _physical(scene, fields):
            write_slot(model, slot, values[row])
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = data.contact.geom
        counts = ~away[pairs].any(axis=1) & ~fingers[pairs].all(axis=1)
        deepest[row] = -data.contact.dist[counts].min(initial=0.0)
    return deepest


def _finger_geoms(scene: Scene) -> Array:
    """[ngeom] bool: the physics geoms of the bodies that the finger joints move."""
    model, fingers = scene.physics, scene.layout.finger_qpos
    joints = np.isin(model.jnt_qposadr, fingers)
    return np.isin(model.geom_bodyid, model.jnt_bodyid[joints])


def _physical(
    scene: Scene, fields: Mapping[str, Array]
) -> Iterator[tuple[Slot, Array]]:
    """Slot in the physics model, and values, of the fields that it has."""
    for drawn, slot in zip(scene.layout.fields, scene.physics_fields, strict=True):
        if slot is not None and drawn.name in fields:
            yield slot, fields[drawn.name]
