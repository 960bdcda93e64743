"""SceneVariation: the rows of model fields that vary a scene's physical quantities."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from manip.sim.fields import read_slot
from manip.sim.not_copied import NotCopied
from manip.sim.scene import GAINS, Scene
from manip.sim.sensors import Sensors
from manip.sim.slots import Slot
from manip.sim.variation import CHANGES, check_change, gains, varied_parts

Array = np.ndarray

CONTROLLER = "controller_stiffness"
"""The quantity that changes the controller's gains instead of the model."""


class SceneVariation(NotCopied):
    """Compute the entries of a varied scene for values of its quantities.

    Args:
        scene: the scene as it was compiled.
        sensors: of the task.
        quantities: names in `CHANGES`, or `CONTROLLER`.

    Raises:
        UserError: a quantity cannot vary in this scene.

    Attributes:
        scene: the scene with `Scene.varied`, for a batch engine.
    """

    def __init__(
        self, scene: Scene, sensors: Sensors, quantities: Sequence[str]
    ) -> None:
        self._given = scene, sensors, quantities
        self._model = mujoco.MjModel.__copy__(scene.physics)
        self._data = mujoco.MjData(self._model)
        robots = scene.layout.robots
        self._arm = robots[0].arm
        self._parts = varied_parts(scene.physics, sensors, robots)
        self._changes = [name for name in CHANGES if name in quantities]
        for name in self._changes:
            check_change(scene.physics, self._parts, name)
        arrays = dict.fromkeys(a for n in self._changes for a in CHANGES[n].arrays)
        self._compiled = {name: getattr(self._model, name).copy() for name in arrays}
        slots = [slot for name in arrays for slot in self._slots(name)]
        if CONTROLLER in quantities:
            slots.append(Slot("varied gains", GAINS, 0, 2))
        self.scene = replace(scene, varied=tuple(slots))

    def rows(self, values: Mapping[str, float]) -> dict[str, Array]:
        """Entries [k] of each varied slot, for values of all quantities."""
        for array, compiled in self._compiled.items():
            getattr(self._model, array)[:] = compiled
        for name in self._changes:
            CHANGES[name].apply(self._model, self._parts, values[name])
        mujoco.mj_setConst(self._model, self._data)
        return {slot.name: self._row(slot, values) for slot in self.scene.varied}

    def __deepcopy__(self, memo: dict[int, Any]) -> "SceneVariation":
        """Another one of the same scene."""
        return SceneVariation(*self._given)

    def _row(self, slot: Slot, values: Mapping[str, float]) -> Array:
        if slot.array == GAINS:
            return np.array(gains(self._arm.kp, self._arm.kd, values[CONTROLLER]))
        return read_slot(self._model, slot)

    def _slots(self, array: str) -> list[Slot]:
        """The whole array; of bounding volumes, which meshes have many of, the objects'
        only.
        """
        if array != "bvh_aabb":
            size = getattr(self._model, array).size
            return [Slot(f"varied {array}", array, 0, size)]
        model, bodies = self._model, self._parts.bodies
        starts, sizes = model.body_bvhadr[bodies], model.body_bvhnum[bodies]
        return [
            Slot(f"varied {array} {body}", array, 6 * int(start), 6 * int(size))
            for body, start, size in zip(bodies, starts, sizes, strict=True)
        ]


def draw_sizes(scene: Scene, model: mujoco.MjModel, row: Mapping[str, Array]) -> None:
    """Give the geoms of a model that is drawn the sizes of varied entries, if any."""
    sizes = row.get("varied geom_size")
    if sizes is None:
        return
    physics = scene.physics
    scales = sizes.reshape(-1, 3)[:, 0] / physics.geom_size[:, 0]
    for body in np.unique(physics.geom_bodyid[scales != 1.0]):
        scale = scales[physics.geom_bodyid == body].max()
        for geom in np.flatnonzero(model.geom_bodyid == body):
            model.geom_size[geom] *= scale
            model.geom_pos[geom] *= scale
