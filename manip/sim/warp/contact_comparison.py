"""Compare the contacts of MuJoCo Warp with those of C, in the present states."""

import mujoco
import numpy as np

from manip.sim.fields import write_slot
from manip.sim.scene import Scene
from manip.sim.warp.contact_differences import ContactDifferences
from manip.sim.warp.device_model import model_slots
from manip.sim.warp.warp_engine import WarpEngine

Array = np.ndarray
Pair = tuple[int, int]


def compare_contacts(
    engine: WarpEngine, differences: dict[str, ContactDifferences]
) -> None:
    """Add the contacts in the present states, which were just set, to `differences`.

    Contacts of parked bodies, which Warp leaves out, do not count.
    """
    scene, warp = engine.scene, _warp_contacts(engine)
    for env_id, state in enumerate(engine.states):
        native = _native_contacts(scene, _model(engine, state), state)
        for pair in native.keys() | warp[env_id].keys():
            kind = differences.setdefault(_kind(scene, pair), ContactDifferences())
            kind.add(native.get(pair, []), warp[env_id].get(pair, []))


def _warp_contacts(engine: WarpEngine) -> list[dict[Pair, list[float]]]:
    """For each environment: pair of geoms -> depths [m] of its contacts."""
    data = engine.on_device.data
    count = int(data.nacon.numpy()[0])
    arrays = (data.contact.worldid, data.contact.geom, data.contact.dist)
    env_ids, geoms, distances = (array.numpy()[:count] for array in arrays)
    contacts: list[dict[Pair, list[float]]] = [{} for _ in range(engine.num_envs)]
    for env_id, pair, distance in zip(env_ids, geoms, distances, strict=True):
        if distance < 0:
            key = min(pair), max(pair)
            contacts[env_id].setdefault(key, []).append(-float(distance))
    return contacts


def _native_contacts(
    scene: Scene, model: mujoco.MjModel, state: Array
) -> dict[Pair, list[float]]:
    data = mujoco.MjData(model)
    data.qpos[:] = state[: model.nq]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    contacts: dict[Pair, list[float]] = {}
    parked = scene.parked_geoms
    for contact in data.contact:
        pair = min(contact.geom), max(contact.geom)
        if contact.dist < 0 and not parked[[*pair]].any():
            contacts.setdefault(pair, []).append(-float(contact.dist))
    return contacts


def _model(engine: WarpEngine, state: Array) -> mujoco.MjModel:
    """The physics model with the fields of a state row."""
    model = mujoco.MjModel.__copy__(engine.scene.physics)
    fields = (*engine.scene.layout.fields, *engine.scene.varied)
    for named, slot in zip(fields, model_slots(engine.scene), strict=True):
        if slot is not None:
            write_slot(model, slot, state[engine.state_columns(named.name)])
    return model


def _kind(scene: Scene, pair: Pair) -> str:
    kinds = [mujoco.mjtGeom(scene.physics.geom_type[geom]).name for geom in pair]
    return "-".join(sorted(kind.removeprefix("mjGEOM_").lower() for kind in kinds))
