"""Triangles: the surface of a geom as a triangle mesh."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from manip.sim.vertex_clusters import cluster_means, clusters, distinct_faces

Array = np.ndarray

SEGMENTS = 24
"""Corners of a circle."""

FINEST, COARSEST = 0.0015, 0.02
"""Range of the cells [m] in which the vertices of a mesh are merged."""

CELLS = 28
"""Cells along the longest side of a mesh."""

CREASE = 0.75
"""Cosine of the largest angle between normals that are merged: 41 degrees."""

_PLANE_HALF = 2.0
"""Half width [m] of a plane that MuJoCo draws without end."""


@dataclass(frozen=True)
class Triangles:
    """A triangle mesh.

    Attributes:
        positions: [V, 3] m.
        normals: [V, 3], of unit length.
        faces: [F, 3] int, rows of the vertices, counterclockwise from outside.
    """

    positions: Array
    normals: Array
    faces: Array

    def moved(self, position: Array, rotation: Array) -> "Triangles":
        """The mesh turned by a matrix [3, 3], then moved by a position [3] m."""
        return Triangles(
            self.positions @ rotation.T + position,
            self.normals @ rotation.T,
            self.faces,
        )


def geom_triangles(model: mujoco.MjModel, geom: int) -> Triangles | None:
    """The surface of a geom in its own frame; None for a height field or SDF."""
    kind = int(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _thinned(_mesh(model, int(model.geom_dataid[geom])))
    return primitive_triangles(kind, model.geom_size[geom])


def primitive_triangles(kind: int, size: Array) -> Triangles | None:
    """The surface of a primitive of MuJoCo's type and sizes [3] m, in its frame."""
    make = _PRIMITIVES.get(kind)
    return make(np.asarray(size, float)) if make else None


def _mesh(model: mujoco.MjModel, mesh: int) -> Triangles:
    """A mesh with a vertex for each corner of each triangle."""
    faces = _rows(model, mesh, "face")
    vertices = model.mesh_face[faces] + model.mesh_vertadr[mesh]
    normals = model.mesh_facenormal[faces] + model.mesh_normaladr[mesh]
    return Triangles(
        model.mesh_vert[vertices].reshape(-1, 3).astype(float),
        model.mesh_normal[normals].reshape(-1, 3).astype(float),
        np.arange(vertices.size).reshape(-1, 3),
    )


def _rows(model: mujoco.MjModel, mesh: int, name: str) -> slice:
    start = int(getattr(model, f"mesh_{name}adr")[mesh])
    return slice(start, start + int(getattr(model, f"mesh_{name}num")[mesh]))


def _thinned(mesh: Triangles) -> Triangles:
    """Merge the vertices in a cell, and of these the normals that point alike."""
    extent = float(np.ptp(mesh.positions, axis=0).max())
    place = clusters(mesh.positions, float(np.clip(extent / CELLS, FINEST, COARSEST)))
    means = cluster_means(mesh.normals, place)
    means /= np.linalg.norm(means, axis=1, keepdims=True) + 1e-9
    alike = (means[place] * mesh.normals).sum(1) > CREASE
    side = np.abs(mesh.normals).argmax(1)
    sign = np.take_along_axis(mesh.normals, side[:, None], 1)[:, 0] > 0
    group = np.where(alike, 0, 1 + 2 * side + sign)
    _, vertex = np.unique(place * 7 + group, return_inverse=True)
    normals = cluster_means(mesh.normals, vertex)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-9
    positions = cluster_means(cluster_means(mesh.positions, place)[place], vertex)
    faces = mesh.faces[distinct_faces(place[mesh.faces])]
    return _used(Triangles(positions, normals, vertex[faces]))


def _used(mesh: Triangles) -> Triangles:
    """Leave out the vertices that no triangle has."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return Triangles(mesh.positions[used], mesh.normals[used], faces.reshape(-1, 3))


def _box(size: Array) -> Triangles:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    positions, normals = [], []
    for axis in range(3):
        for sign in (-1, 1):
            side = np.full((4, 3), float(sign))
            side[:, [(axis + 1) % 3, (axis + 2) % 3]] = corners[::sign]
            positions.append(side * size)
            normals.append(np.tile(sign * np.eye(3)[axis], (4, 1)))
    quads = np.arange(24).reshape(6, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Triangles(np.concatenate(positions), np.concatenate(normals), faces)


def _plane(size: Array) -> Triangles:
    half = np.where(size[:2] > 0, size[:2], _PLANE_HALF)
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    up = np.tile([0.0, 0.0, 1.0], (4, 1))
    return Triangles(corners * [*half, 0], up, np.array([[0, 1, 2], [0, 2, 3]]))


def _turned(profile: Array, normals: Array) -> Triangles:
    """A profile, points [P, 2] of radius and height from below, turned about z."""
    angle = np.linspace(0, 2 * np.pi, SEGMENTS + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    positions, around = (
        np.concatenate(
            [
                values[:, None, :1] * ring,
                np.broadcast_to(values[:, None, 1:], (len(values), len(ring), 1)),
            ],
            axis=2,
        ).reshape(-1, 3)
        for values in (profile, normals)
    )
    row = np.arange(len(profile) - 1)[:, None] * len(ring)
    low = (row + np.arange(SEGMENTS)).reshape(-1)
    high = low + len(ring)
    faces = np.stack([low, low + 1, high + 1, low, high + 1, high], 1).reshape(-1, 3)
    return Triangles(positions, around, faces)


def _cylinder(size: Array) -> Triangles:
    radius, half = size[:2]
    edge = [[0, -half], [radius, -half], [radius, -half]]
    profile = np.array([*edge, *([r, -h] for r, h in edge[::-1])])
    normals = np.array([[0, -1], [0, -1], [1, 0], [1, 0], [0, 1], [0, 1]], float)
    return _turned(profile, normals)


def _capsule(size: Array) -> Triangles:
    radius, half = size[:2]
    angle = np.linspace(-np.pi / 2, np.pi / 2, SEGMENTS // 2)
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = np.stack([np.zeros_like(angle), half * np.sign(angle)], axis=1)
    return _turned(radius * normals + ends, normals)


def _ellipsoid(size: Array) -> Triangles:
    ball = _capsule(np.array([1.0, 0.0, 0.0]))
    normals = ball.normals / size
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Triangles(ball.positions * size, normals, ball.faces)


def _sphere(size: Array) -> Triangles:
    return _capsule(np.array([size[0], 0.0, 0.0]))


_GEOM = mujoco.mjtGeom
_PRIMITIVES: dict[int, Callable[[Array], Triangles]] = {
    int(_GEOM.mjGEOM_PLANE): _plane,
    int(_GEOM.mjGEOM_SPHERE): _sphere,
    int(_GEOM.mjGEOM_CAPSULE): _capsule,
    int(_GEOM.mjGEOM_ELLIPSOID): _ellipsoid,
    int(_GEOM.mjGEOM_CYLINDER): _cylinder,
    int(_GEOM.mjGEOM_BOX): _box,
}
