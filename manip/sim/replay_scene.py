"""ReplayScene: what a viewer of triangles needs to show recorded states.

The bodies of robosuite's full model and their colours, and for each state the pose of
each body in its parent.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from manip.sim.renderer import VISUAL_GROUP
from manip.sim.triangles import Triangles, geom_triangles, primitive_triangles

Array = np.ndarray

_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
_UNSET = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's default colour of a geom, in place of which it draws the material's."""


@dataclass(frozen=True)
class Part:
    """A body, or a marked goal, with its surface.

    Attributes:
        name: of the body or site.
        parent: number of the part in whose frame it moves; None for the world.
        surfaces: triangles in the part's frame, each with its colour RGBA [4] in 0-1.
    """

    name: str
    parent: int | None
    surfaces: tuple[tuple[Triangles, Array], ...]


def replay_parts(model: mujoco.MjModel) -> list[Part]:
    """The world, all bodies in MuJoCo's order, then the sites with "goal" in the name.

    Floor and walls are left out: they would hide the rest from some sides.
    """
    parents = [None, *map(int, model.body_parentid[1:])]
    bodies = [
        Part(model.body(body).name, parent, tuple(_surfaces(model, body)))
        for body, parent in enumerate(parents)
    ]
    return bodies + [_goal(model, site) for site in _goals(model)]


class PoseReader:
    """Compute the poses of the parts of `replay_parts` from recorded states.

    Args:
        model: robosuite's full model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._data = mujoco.MjData(model)

    def read(self, model: mujoco.MjModel, states: Array) -> tuple[Array, Array]:
        """Poses of P parts, each in its parent's frame.

        Args:
            model: with the fields of the states' episode.
            states: qpos [T, nq].

        Returns:
            Positions [T, P, 3] m and unit quaternions [T, P, 4] wxyz.
        """
        positions, rotations = self._in_world(model, states)
        parents, sites = model.body_parentid, _goals(model)
        inverse = rotations[:, parents] * (1, -1, -1, -1)
        apart = positions - positions[:, parents]
        positions, rotations = _rotated(inverse, apart), _product(inverse, rotations)
        fixed = np.ones((len(states), 1, 1))
        return (
            np.concatenate([positions, fixed * model.site_pos[sites]], axis=1),
            np.concatenate([rotations, fixed * model.site_quat[sites]], axis=1),
        )

    def _in_world(self, model: mujoco.MjModel, states: Array) -> tuple[Array, Array]:
        data = self._data
        positions = np.empty((len(states), model.nbody, 3))
        rotations = np.empty((len(states), model.nbody, 4))
        for step, state in enumerate(states):
            data.qpos[:] = state
            mujoco.mj_kinematics(model, data)
            positions[step], rotations[step] = data.xpos, data.xquat
        return positions, rotations


def _goals(model: mujoco.MjModel) -> list[int]:
    return [i for i in range(model.nsite) if "goal" in model.site(i).name]


def _goal(model: mujoco.MjModel, site: int) -> Part:
    surface = primitive_triangles(int(model.site_type[site]), model.site_size[site])
    colour = np.abs(model.site_rgba[site])  # robosuite hides one by a negative alpha
    surfaces = ((surface, colour),) if surface else ()
    return Part(model.site(site).name, int(model.site_bodyid[site]), surfaces)


def _surfaces(model: mujoco.MjModel, body: int) -> Iterator[tuple[Triangles, Array]]:
    start, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    for geom in range(start, start + count):
        if not _is_drawn(model, geom):
            continue
        surface, matrix = geom_triangles(model, geom), np.empty(9)
        mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
        if surface:
            place = model.geom_pos[geom], matrix.reshape(3, 3)
            yield surface.moved(*place), _colour(model, geom)


def _is_drawn(model: mujoco.MjModel, geom: int) -> bool:
    shown = model.geom_group[geom] == VISUAL_GROUP and _colour(model, geom)[3] > 0
    room = model.geom_bodyid[geom] == 0 and (
        model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        or "wall" in model.geom(geom).name
    )
    return bool(shown and not room)


def _colour(model: mujoco.MjModel, geom: int) -> Array:
    """RGBA [4] in 0-1: the geom's or its material's, times the mean of its texture."""
    colour, material = model.geom_rgba[geom].astype(float), int(model.geom_matid[geom])
    if material < 0:
        return colour
    if np.allclose(colour, _UNSET):
        colour = model.mat_rgba[material].astype(float)
    texture = int(model.mat_texid[material, _RGB])
    if texture >= 0:
        colour[:3] *= _mean_colour(model, texture)
    return colour


def _mean_colour(model: mujoco.MjModel, texture: int) -> Array:
    """RGB [3] in 0-1."""
    start, channels = int(model.tex_adr[texture]), int(model.tex_nchannel[texture])
    size = int(model.tex_height[texture]) * int(model.tex_width[texture]) * channels
    pixels = model.tex_data[start : start + size].reshape(-1, channels)
    mean: Array = pixels[:, : min(3, channels)].mean(0) / 255
    return mean


def _product(a: Array, b: Array) -> Array:
    """Product [..., 4] of quaternions wxyz."""
    vector = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:]
    vector += np.cross(a[..., 1:], b[..., 1:])
    scalar = a[..., 0] * b[..., 0] - (a[..., 1:] * b[..., 1:]).sum(-1)
    return np.concatenate([scalar[..., None], vector], axis=-1)


def _rotated(rotation: Array, vector: Array) -> Array:
    """Vectors [..., 3] turned by unit quaternions [..., 4] wxyz."""
    twice = 2 * np.cross(rotation[..., 1:], vector)
    turned: Array = vector + rotation[..., :1] * twice
    return turned + np.cross(rotation[..., 1:], twice)
