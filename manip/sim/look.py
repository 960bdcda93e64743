"""Change how a model looks: colours, textures, lights, camera poses."""

import mujoco
import numpy as np

from manip.looks import Looks
from manip.sim.textured_model import Textures
from manip.sim.thin_meshes import ARM_BODIES

Array = np.ndarray

USUAL = 0.25
"""Fraction of the episodes in training that have robosuite's own look."""
TINT = 0.3
"""Largest relative change of each colour channel."""
RETEXTURED = 0.7
"""Fraction of the surroundings' textures that are replaced."""
LIGHT_TURN = 0.5
"""Largest change of each entry of a light's direction, a unit vector (about 30
degrees; robosuite's light is directional: it has no place)."""
BRIGHTNESS = 0.5
"""Largest relative change of a light's brightness."""
SHIFT, WRIST_SHIFT = 0.03, 0.005
"""Largest shift of a camera [m], of one on the arm."""
TURN, WRIST_TURN = 0.07, 0.035
"""Largest turn of a camera about each axis [rad], of one on the arm."""

_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)

_CHANGED = {
    "colours": ("mat_rgba", "geom_rgba"),
    "textures": ("mat_texid",),
    "lights": ("light_dir", "light_diffuse", "light_ambient"),
    "cameras": ("cam_pos", "cam_quat"),
}


class Look:
    """Give a model the look of a seed, in place.

    A fraction USUAL of the looks is robosuite's own, whose white table is at the edge
    of all colours. The others use a share of the ranges above that is uniform from 0 to
    the strength. Unseen looks lie on the edges of the ranges, and their textures are of
    other patterns.

    Args:
        model: with the additional textures.
        textures: their ids.
        looks: what varies.
    """

    def __init__(self, model: mujoco.MjModel, textures: Textures, looks: Looks) -> None:
        self._model, self._looks = model, looks
        self._textures = textures.test if looks.unseen else textures.training
        self._base = {
            name: getattr(model, name).copy()
            for group in looks.groups
            for name in _CHANGED[group]
        }
        self._share = 1.0
        self._surroundings = _surrounding_materials(model)
        headlight = model.vis.headlight
        self._headlight = headlight.diffuse.copy(), headlight.ambient.copy()

    def apply(self, seed: int) -> None:
        """Change the model to the look of a seed."""
        rng = np.random.Generator(np.random.Philox(key=seed))
        varied = max(0.0, (rng.random() - USUAL) / (1 - USUAL))
        self._share = self._looks.strength * varied
        for group in self._looks.groups:
            getattr(self, f"_change_{group}")(rng)

    def _range(self, rng: np.random.Generator, *shape: int) -> Array:
        """Numbers within +-share; of unseen looks on the edge."""
        values = rng.uniform(-1, 1, shape)
        return np.sign(values) if self._looks.unseen else self._share * values

    def _change_colours(self, rng: np.random.Generator) -> None:
        for name in _CHANGED["colours"]:
            base = self._base[name]
            factor = 1 + TINT * self._range(rng, len(base), 3)
            getattr(self._model, name)[:, :3] = np.clip(base[:, :3] * factor, 0, 1)

    def _change_textures(self, rng: np.random.Generator) -> None:
        ids = self._base["mat_texid"].copy()
        share = 1.0 if self._looks.unseen else RETEXTURED * self._share
        for material in self._surroundings:
            replaced, choice = rng.random() < share, rng.random()
            known = self._textures[int(self._model.tex_type[ids[material, _RGB]])]
            if replaced:
                ids[material, _RGB] = known[int(choice * len(known))]
        self._model.mat_texid[:] = ids  # see Canvas.set_textures

    def _change_lights(self, rng: np.random.Generator) -> None:
        model, base = self._model, self._base
        direction = base["light_dir"] + LIGHT_TURN * self._range(rng, model.nlight, 3)
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        model.light_dir[:] = direction / length
        factor = 1 + BRIGHTNESS * self._range(rng, model.nlight, 1)
        for name in ("light_diffuse", "light_ambient"):
            getattr(model, name)[:] = base[name] * factor
        overall = 1 + BRIGHTNESS * self._range(rng, 1)
        diffuse, ambient = self._headlight
        model.vis.headlight.diffuse = diffuse * overall
        model.vis.headlight.ambient = ambient * overall

    def _change_cameras(self, rng: np.random.Generator) -> None:
        model, base = self._model, self._base
        moving = (model.cam_bodyid > 0)[:, None]
        shift = np.where(moving, WRIST_SHIFT, SHIFT) * self._range(rng, model.ncam, 3)
        model.cam_pos[:] = base["cam_pos"] + shift
        turns = np.where(moving, WRIST_TURN, TURN) * self._range(rng, model.ncam, 3)
        for camera, turn in enumerate(turns):
            quat = base["cam_quat"][camera].copy()
            mujoco.mju_quatIntegrate(quat, turn, 1.0)
            model.cam_quat[camera] = quat


def _surrounding_materials(model: mujoco.MjModel) -> Array:
    """Ids of textured materials of geoms that are fixed to the world, not the arm's."""
    fixed = model.body_weldid[model.geom_bodyid] == 0
    names = [model.body(body).name for body in model.geom_bodyid]
    arm = np.array([name.startswith(ARM_BODIES) for name in names])
    materials = np.unique(model.geom_matid[fixed & ~arm])
    materials = materials[materials >= 0]
    return materials[model.mat_texid[materials, _RGB] >= 0]
