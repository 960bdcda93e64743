"""VariedStarts: start states of episodes whose simulations differ."""

from collections.abc import Mapping, Sequence

import numpy as np

from manip.envs.task import Start
from manip.sim.scene import Scene
from manip.sim.scene_variation import CONTROLLER, SceneVariation
from manip.sim.sensors import Sensors
from manip.sim.stock_variation import START_NOISE
from manip.sim.variation import CHANGES

Array = np.ndarray


class VariedStarts:
    """Add to start states the values of the simulation's quantities.

    Args:
        scene: the scene as it was compiled.
        sensors: of the task.
        quantities: names of what differs, of which those of a model are taken.

    Raises:
        UserError: a quantity cannot vary in this scene.

    Attributes:
        scene: for the engine that gets the start states.
    """

    def __init__(
        self, scene: Scene, sensors: Sensors, quantities: Sequence[str]
    ) -> None:
        fields = [name for name in quantities if name in (*CHANGES, CONTROLLER)]
        self._variation = SceneVariation(scene, sensors, fields) if fields else None
        self.scene = self._variation.scene if self._variation else scene

    def apply(self, start: Start, values: Mapping[str, Array]) -> Start:
        """The start states of n episodes with values [n] of each quantity."""
        qpos, fields = start.qpos, dict(start.fields)
        if START_NOISE in values:
            arms, rest = self.scene.layout.joint_qpos, self.scene.layout.qpos
            qpos = qpos.copy()
            noise = qpos[:, arms] - rest[arms]
            qpos[:, arms] = rest[arms] + values[START_NOISE][:, None] * noise
        if self._variation and len(qpos):
            rows = [
                self._variation.rows({name: v[index] for name, v in values.items()})
                for index in range(len(qpos))
            ]
            fields |= {name: np.stack([row[name] for row in rows]) for name in rows[0]}
        return Start(qpos, fields)
