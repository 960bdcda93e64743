"""Model fields: entries of MjModel that differ between environments."""

from collections.abc import Mapping

import mujoco
import numpy as np

from manip.errors import UserError, unknown
from manip.sim.names import find, lookup
from manip.sim.slots import Slot

Array = np.ndarray

_OBJECTS = {
    "body": "body", "geom": "geom", "site": "site", "dof": "joint", "jnt": "joint",
    "actuator": "actuator", "cam": "camera", "light": "light", "mat": "material",
}  # fmt: skip
"""Prefix of a model array -> the kind of object that names its rows."""

_ROWS = {
    "body": "nbody", "geom": "ngeom", "site": "nsite", "dof": "nv", "jnt": "njnt",
    "actuator": "nu", "cam": "ncam", "light": "nlight", "mat": "nmat",
}  # fmt: skip
"""Prefix of a model array -> the size of MjModel that counts its rows."""

_DRAWN_ONLY = ("cam", "light", "mat")

_DERIVED = {
    "aabb", "acc0", "dir0", "invweight0", "length", "length0", "lengthrange", "mat0",
    "M0", "pos0", "poscom0", "rbound", "subtreemass",
}  # fmt: skip
"""Endings of arrays that MuJoCo computes from others: not to be set."""


def field_slots(
    model: mujoco.MjModel, fields: Mapping[str, tuple[str, str]]
) -> tuple[Slot, ...]:
    """Where fields, name -> (model array, object), lie in the stock model.

    Raises:
        UserError: an array or an object does not exist.
    """
    return tuple(_slot(model, name, *field) for name, field in fields.items())


def physics_field_slots(
    model: mujoco.MjModel, fields: Mapping[str, tuple[str, str]]
) -> tuple[Slot | None, ...]:
    """Where the same fields lie in the physics model; None for what only is drawn.

    The physics model lacks visual geoms and materials, and numbers its geoms
    differently. MuJoCo stores colours as float32; physics does not read them.
    """
    return tuple(
        _slot(model, name, array, target) if _simulated(model, array, target) else None
        for name, (array, target) in fields.items()
    )


def read_slot(owner: mujoco.MjModel | mujoco.MjData, slot: Slot) -> Array:
    """Copy of the entries of a slot, [size] float64."""
    flat = getattr(owner, slot.array).reshape(-1)
    return flat[slot.start : slot.start + slot.size].astype(np.float64)


def write_slot(owner: mujoco.MjModel, slot: Slot, values: Array) -> None:
    """Set the entries of a slot to values [size]."""
    flat = getattr(owner, slot.array).reshape(-1)
    flat[slot.start : slot.start + slot.size] = values


def _slot(model: mujoco.MjModel, name: str, array: str, target: str) -> Slot:
    known = [entry for entry in dir(model) if _has_rows_of_floats(model, entry)]
    if array not in known:
        raise unknown("model array", array, known)
    kind = array.split("_")[0]
    row, rows = lookup(model, _OBJECTS[kind], target), 1
    _check_frame(model, array, target, row)
    if kind == "dof":
        joint = row
        row = int(model.jnt_dofadr[joint])
        rows = int((model.dof_jntid == joint).sum())
    size = getattr(model, array)[0].size
    return Slot(name, array, size * row, size * rows)


def _check_frame(model: mujoco.MjModel, array: str, target: str, row: int) -> None:
    """Refuse a pose that MuJoCo takes from the body instead (mj_local2Global)."""
    kind, entry = array.split("_")[0], array.split("_")[-1].removeprefix("i")
    if kind not in ("body", "geom", "site") or array in ("body_pos", "body_quat"):
        return
    frame, kinds = getattr(model, f"{kind}_sameframe")[row], mujoco.mjtSameFrame
    whole = frame in (kinds.mjSAMEFRAME_BODY, kinds.mjSAMEFRAME_INERTIA)
    if (entry == "pos" and whole) or (entry == "quat" and frame):
        raise UserError(
            f"{array} of {target!r} cannot be set: {kind} and body share a frame, and "
            f"MuJoCo ignores {array} then; give the {kind} another pose in the model"
        )


def _has_rows_of_floats(model: mujoco.MjModel, array: str) -> bool:
    """Whether the model array has a row of floats for each object of a named kind."""
    kind = array.split("_")[0]
    if kind not in _ROWS or array.removeprefix(f"{kind}_") in {kind, *_DERIVED}:
        return False
    values = getattr(model, array)
    return (
        isinstance(values, np.ndarray)
        and values.dtype.kind == "f"
        and values.size > 0
        and len(values) == getattr(model, _ROWS[kind])
    )


def _simulated(model: mujoco.MjModel, array: str, target: str) -> bool:
    kind = array.split("_")[0]
    drawn = kind in _DRAWN_ONLY or getattr(model, array).dtype != np.float64
    return not drawn and find(model, _OBJECTS[kind], target) >= 0
