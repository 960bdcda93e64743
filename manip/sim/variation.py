"""Vary physical quantities of a compiled model, such as masses, friction and gains.

Each function changes an MjModel in place; `mj_setConst` then computes the constants
that MuJoCo derives from it. The same functions serve the batch engine and robosuite.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from manip.errors import UserError
from manip.sim.names import lookup
from manip.sim.robot_model import Robot
from manip.sim.sensors import Sensors

Array = np.ndarray


class Varied(NamedTuple):
    """Indices of what varies.

    Attributes:
        bodies: the task's objects, with all bodies below them.
        dofs: of the arms.
        fingers: actuators of the grippers.
    """

    bodies: Array
    dofs: Array
    fingers: Array


def varied_parts(
    model: mujoco.MjModel, sensors: Sensors, robots: Sequence[Robot]
) -> Varied:
    """What varies in a model: the bodies that a task reads and does not park, if they
    can move and are no part of a robot; the arms; the grippers.
    """
    arms = [robot.arm for robot in robots]
    of_robots = {arm.root for arm in arms}
    names = [n for n in sensors.bodies.values() if n not in sensors.parked]
    roots = [lookup(model, "body", name) for name in names]
    inside = [body for body in range(model.nbody) if _is_below(model, body, roots)]
    moving = [
        body
        for body in inside
        if model.body_weldid[body] and model.body_rootid[body] not in of_robots
    ]
    return Varied(
        np.array(moving, int),
        np.concatenate([arm.dof for arm in arms]),
        np.concatenate([robot.gripper.actuator for robot in robots]),
    )


def _is_below(model: mujoco.MjModel, body: int, roots: list[int]) -> bool:
    while body > 0 and body not in roots:
        body = int(model.body_parentid[body])
    return body > 0


def scale_mass(model: mujoco.MjModel, parts: Varied, factor: float) -> None:
    """Multiply masses and inertias of the objects."""
    model.body_mass[parts.bodies] *= factor
    model.body_inertia[parts.bodies] *= factor


def scale_size(model: mujoco.MjModel, parts: Varied, factor: float) -> None:
    """Multiply lengths of the objects about their origin; masses stay the same."""
    for geom in geoms_of(model, parts.bodies):
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
            model.geom_size[geom] *= factor
            model.geom_pos[geom] *= factor
            model.geom_rbound[geom] *= factor
            model.geom_aabb[geom] *= factor
    for body in parts.bodies:
        start, size = model.body_bvhadr[body], model.body_bvhnum[body]
        model.bvh_aabb[start : start + size] *= factor
    model.body_ipos[parts.bodies] *= factor
    model.body_inertia[parts.bodies] *= factor**2


def scale_friction(model: mujoco.MjModel, parts: Varied, factor: float) -> None:
    """Multiply all friction coefficients of all geoms.

    MuJoCo takes the larger coefficient of two geoms in contact, so the objects' alone
    would have no effect at rubber finger pads.
    """
    model.geom_friction[:] *= factor


def add_damping(model: mujoco.MjModel, parts: Varied, damping: float) -> None:
    """Add damping [N m s/rad] to the joints of the arms."""
    model.dof_damping[parts.dofs] += damping


def scale_grip(model: mujoco.MjModel, parts: Varied, factor: float) -> None:
    """Multiply the force of the grippers' actuators, and the limit of it."""
    for array in (model.actuator_gainprm, model.actuator_biasprm):
        array[parts.fingers] *= factor
    model.actuator_forcerange[parts.fingers] *= factor


def geoms_of(model: mujoco.MjModel, bodies: Array) -> Array:
    """[k] int: the geoms of some bodies."""
    return np.flatnonzero(np.isin(model.geom_bodyid, bodies))


class Change(NamedTuple):
    """How a quantity changes a model, and the arrays that differ afterwards."""

    apply: Callable[[mujoco.MjModel, Varied, float], None]
    arrays: tuple[str, ...]


_INERTIAL = (
    *("body_inertia", "body_invweight0", "dof_invweight0", "dof_M0"),
    *("body_mass", "body_subtreemass"),
)

CHANGES = {
    "object_mass": Change(scale_mass, _INERTIAL),
    "object_size": Change(
        scale_size,
        (
            *("geom_size", "geom_pos", "geom_rbound", "geom_aabb", "bvh_aabb"),
            *("body_ipos", *_INERTIAL),
        ),
    ),
    "friction": Change(scale_friction, ("geom_friction",)),
    "joint_damping": Change(add_damping, ("dof_damping",)),
    "gripper_force": Change(
        scale_grip, ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
    ),
}
"""Quantity -> its change of a model."""


def check_change(model: mujoco.MjModel, parts: Varied, quantity: str) -> None:
    """Raise `UserError` unless a quantity of a model can vary."""
    if quantity in ("object_mass", "object_size") and not len(parts.bodies):
        raise UserError(f"{quantity} cannot vary: the task has no object that moves")
    if quantity == "object_size":
        geoms = geoms_of(model, parts.bodies)
        collides = geoms[model.geom_contype[geoms] != 0]
        if (model.geom_type[collides] == mujoco.mjtGeom.mjGEOM_MESH).any():
            raise UserError("object_size cannot vary: the object's shape is a mesh")
    if quantity == "gripper_force" and not len(parts.fingers):
        raise UserError("gripper_force cannot vary: the robot has no gripper")


def gains(kp: Any, kd: Any, factor: float) -> tuple[Any, Any]:
    """kp and kd with another stiffness, damped as before: kd is 2 ratio sqrt(kp)."""
    return kp * factor, kd * np.sqrt(factor)
