"""The stock model of one episode as MJCF, for programs that load it themselves."""

from collections.abc import Mapping

import mujoco
import numpy as np

from manip.sim.scene import Scene

Array = np.ndarray


def episode_model(
    scene: Scene, fields: Mapping[str, tuple[str, str]], values: Mapping[str, Array]
) -> str:
    """The stock model, with the poses of bodies, sites and geoms of an episode.

    Args:
        scene: of the episode.
        fields: name -> (model array, object), as in `Sensors.fields`.
        values: name -> [k], their values in the episode.
    """
    text: str = scene.stock.model.get_xml()
    if not fields:
        return text
    spec = mujoco.MjSpec.from_string(text)
    for name, (array, target) in fields.items():
        kind, entry = array.split("_", 1)
        if kind in ("body", "site", "geom") and entry in ("pos", "quat"):
            setattr(getattr(spec, kind)(target), entry, values[name])
    return str(spec.to_xml())
