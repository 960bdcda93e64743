"""A scene's drawn model with additional textures, which materials can be given."""

from copy import copy
from typing import Any, NamedTuple

import mujoco
import numpy as np

from manip.sim.patterns import SIZE, TEST, TRAINING, test_pattern, training_pattern
from manip.sim.scene import Scene

Array = np.ndarray

_2D, _CUBE = mujoco.mjtTexture.mjTEXTURE_2D, mujoco.mjtTexture.mjTEXTURE_CUBE


class Textures(NamedTuple):
    """Ids of the additional textures, for each kind of texture: 2-D, cube.

    Attributes:
        training: kind -> [TRAINING].
        test: kind -> [TEST], of patterns that no training look has.
    """

    training: dict[int, Array]
    test: dict[int, Array]


def textured_model(scene: Scene, varied: bool) -> tuple[mujoco.MjModel, Textures]:
    """A copy of the stock model; compiled with additional textures if `varied`."""
    if not varied:
        return copy(scene.visual), Textures({}, {})
    spec = mujoco.MjSpec.from_string(scene.stock.model.get_xml())
    for kind in (_2D, _CUBE):
        for number in range(TRAINING):
            _add(spec, _name("training", kind, number), kind, training_pattern(number))
        for number in range(TEST):
            _add(spec, _name("test", kind, number), kind, test_pattern(number))
    model = spec.compile()
    _copy_values(scene.visual, model)
    return model, Textures(_ids(model, "training", TRAINING), _ids(model, "test", TEST))


def _name(group: str, kind: Any, number: int) -> str:
    return f"look/{group}/{int(kind)}/{number}"


def _ids(model: mujoco.MjModel, group: str, count: int) -> dict[int, Array]:
    return {
        int(kind): np.array(
            [model.texture(_name(group, kind, number)).id for number in range(count)]
        )
        for kind in (_2D, _CUBE)
    }


def _add(spec: mujoco.MjSpec, name: str, kind: Any, pixels: Array) -> None:
    faces = 6 if kind == _CUBE else 1
    texture = spec.add_texture(
        name=name, type=kind, width=SIZE, height=SIZE * faces, nchannel=3
    )
    texture.data = np.tile(pixels, (faces, 1, 1)).tobytes()


def _copy_values(source: mujoco.MjModel, target: mujoco.MjModel) -> None:
    """Copy what robosuite's reset has changed in the stock model."""
    for name in ("body_pos", "body_quat", "site_pos", "site_rgba", "geom_rgba"):
        getattr(target, name)[:] = getattr(source, name)
