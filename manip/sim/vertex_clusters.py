"""Vertex clustering (Rossignac and Borrel, 1993): fewer triangles for a mesh.

Vertices in one cell of a grid become one vertex; triangles that lose their area are
left out.
"""

import numpy as np

Array = np.ndarray


def clusters(vertices: Array, cell: float) -> Array:
    """[V]: number of the cluster, one for each cell [m] of the grid, of vertices
    [V, 3] m.
    """
    cells = np.floor(vertices / cell).astype(np.int64)
    _, cluster = np.unique(_keys(cells), return_inverse=True)
    return cluster.reshape(-1)


def cluster_means(values: Array, cluster: Array) -> Array:
    """[C, k]: mean over each cluster of the values [V, k] of its vertices."""
    members = np.bincount(cluster)
    sums = [np.bincount(cluster, column) for column in values.T]
    return np.stack(sums, axis=1) / members[:, None]


def distinct_faces(corners: Array) -> Array:
    """Rows, in order, of the triangles [F, 3] of clusters with an area, each once."""
    ordered = np.sort(corners, axis=1)
    _, first = np.unique(_keys(ordered), return_index=True)
    distinct = (np.diff(ordered[first], axis=1) > 0).all(axis=1)
    return np.sort(first[distinct])


def _keys(rows: Array) -> Array:
    """[R]: a number for each row [R, 3] of integers, equal for equal rows only."""
    low = rows.min(axis=0)
    a, b, c = (rows - low).T
    _, height, depth = rows.max(axis=0) - low + 1
    keys: Array = (a * height + b) * depth + c
    return keys
