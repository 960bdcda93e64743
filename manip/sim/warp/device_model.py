"""The scene's physics model on the device."""

from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from manip.sim.scene import GAINS, Scene
from manip.sim.slots import Slot
from manip.sim.warp.columns import Place
from manip.sim.warp.ghost_contacts import drop_ghost_contacts
from manip.sim.warp.sizes import Sizes

CONTACT_MATCHES = 64
"""Least memory for the contacts that one contact sensor finds."""


def host_model(scene: Scene) -> mujoco.MjModel:
    """A copy of the physics model that mujoco_warp accepts.

    Box-box contacts come from the analytic collider. Parked bodies have no contacts:
    in float32 they would be thrown off the floor by metres.
    """
    model, flags = mujoco.MjModel.__copy__(scene.physics), mujoco.mjtDisableBit
    model.opt.disableflags &= ~int(flags.mjDSBL_AUTORESET)
    model.opt.disableflags |= int(flags.mjDSBL_NATIVECCD)
    parked = scene.parked_geoms
    model.geom_contype[parked] = model.geom_conaffinity[parked] = 0
    return model


def device_model(
    scene: Scene, host: mujoco.MjModel, num_envs: int, sizes: Sizes
) -> Any:
    """A mujoco_warp.Model; fields and varied entries have a row per environment."""
    model = mjw.put_model(host)
    matches = max(CONTACT_MATCHES, sizes.nconmax)
    model.opt.contact_sensor_maxmatch = 1 << (matches - 1).bit_length()
    model.callback.contactfilter = drop_ghost_contacts
    for name in {slot.array for slot in model_slots(scene) if slot is not None}:
        if hasattr(model, name):
            shared = getattr(model, name)
            rows = np.repeat(shared.numpy()[:1], num_envs, axis=0)
            setattr(model, name, wp.array(rows, dtype=shared.dtype))
    return model


def device_data(host: mujoco.MjModel, num_envs: int, sizes: Sizes) -> Any:
    """A mujoco_warp.Data."""
    return mjw.make_data(
        host,
        nworld=num_envs,
        njmax=sizes.njmax,
        nconmax=sizes.nconmax,
        njmax_nnz=sizes.njmax * host.nv,
    )


def model_slots(scene: Scene) -> list[Slot | None]:
    """Fields, then varied entries of the physics model, as in a state row.

    None for what is no part of the model: fields that only images show, and gains.
    """
    varied = (None if slot.array == GAINS else slot for slot in scene.varied)
    return [*scene.physics_fields, *varied]


def model_place(model: Any, slot: Slot | None) -> Place | None:
    """Where a field lies on the device; None for one that mujoco_warp does not use."""
    if slot is None or not hasattr(model, slot.array):
        return None
    return Place(getattr(model, slot.array), slot.start, slot.size)
