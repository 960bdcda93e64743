"""Draw the arm's meshes with fewer triangles, by vertex clustering."""

import mujoco
import numpy as np

from manip.sim.vertex_clusters import cluster_means, clusters, distinct_faces

Array = np.ndarray

CELL = 0.02
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
    cluster = clusters(vertices, CELL)
    vertices[:] = cluster_means(vertices, cluster)[cluster]
    _keep_faces(model, mesh, cluster)


def _keep_faces(model: mujoco.MjModel, mesh: int, cluster: Array) -> None:
    """Move the faces whose corners differ, once each, to the front of the mesh's."""
    start, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    rows = slice(start, start + count)
    faces = distinct_faces(cluster[model.mesh_face[rows]])
    for array in (model.mesh_face, model.mesh_facenormal, model.mesh_facetexcoord):
        array[start : start + len(faces)] = array[rows][faces]
    model.mesh_facenum[mesh] = len(faces)
