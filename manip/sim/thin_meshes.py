"""Draw the arm's meshes with fewer triangles.

Vertices in one cell of a grid become one vertex (vertex clustering: Rossignac and
Borrel, 1993); triangles that lose their area are left out.
"""

import mujoco
import numpy as np

Array = np.ndarray

CELL = 0.01
"""Size of a cell [m]. The gripper, which the wrist camera sees from near by, and
objects stay as they are: at 1 cm a can has no shape."""

ARM_BODIES = ("robot", "fixed_mount")
"""Beginnings of the names of an arm's and its mount's bodies in robosuite."""


def thin_arm_meshes(model: mujoco.MjModel) -> None:
    """Thin the meshes of the arm and its mount, in place."""
    for mesh in _arm_meshes(model):
        _thin(model, mesh)


def _arm_meshes(model: mujoco.MjModel) -> set[int]:
    return {
        int(model.geom_dataid[geom])
        for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
        if model.body(model.geom_bodyid[geom]).name.startswith(ARM_BODIES)
    }


def _thin(model: mujoco.MjModel, mesh: int) -> None:
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[start : start + count]
    cells = np.floor(vertices / CELL).astype(np.int64)
    _, cluster = np.unique(cells, axis=0, return_inverse=True)
    cluster = cluster.reshape(-1)
    members = np.bincount(cluster)
    for axis in range(3):
        mean = np.bincount(cluster, vertices[:, axis]) / members
        vertices[:, axis] = mean[cluster]
    _keep_faces(model, mesh, cluster)


def _keep_faces(model: mujoco.MjModel, mesh: int, cluster: Array) -> None:
    """Move the faces whose corners differ, once each, to the front of the mesh's."""
    start, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    rows = slice(start, start + count)
    corners = np.sort(cluster[model.mesh_face[rows]], axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    distinct = (np.diff(corners[first], axis=1) > 0).all(axis=1)
    faces = np.sort(first[distinct])
    for array in (model.mesh_face, model.mesh_facenormal, model.mesh_facetexcoord):
        array[start : start + len(faces)] = array[rows][faces]
    model.mesh_facenum[mesh] = len(faces)
