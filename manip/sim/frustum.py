"""Which geoms a camera cannot see, because they lie outside its field of view."""

import mujoco
import numpy as np

Array = np.ndarray

UNSEEN = 5
"""A geom group that is not drawn."""


class Frustum:
    """The bounding boxes of a model's geoms, compared with a camera's field of view.

    Args:
        model: its geoms with a bounding box are tested; planes have none.
        data: positions of geoms and cameras.
        camera: id of a camera; images are as wide as high.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, camera: int) -> None:
        self._model, self._data, self._camera = model, data, camera
        self._groups = model.geom_group.copy()
        self._bounded = np.flatnonzero(model.geom_rbound > 0)

    def hide_unseen(self) -> None:
        """Put the geoms that the camera cannot see into the group `UNSEEN`."""
        self._model.geom_group[:] = self._groups
        self._model.geom_group[self._bounded[self._outside()]] = UNSEEN

    def _outside(self) -> Array:
        """[G] bool: the box lies beyond one of the five planes."""
        data, rows = self._data, self._bounded
        turn = data.geom_xmat[rows].reshape(-1, 3, 3)
        box = self._model.geom_aabb[rows]
        centre = data.geom_xpos[rows] + np.einsum("gij,gj->gi", turn, box[:, :3])
        normals = self._normals()
        distance = (centre - data.cam_xpos[self._camera]) @ normals.T
        along = np.abs(np.einsum("gij,pi->gpj", turn, normals))
        reach = np.einsum("gpj,gj->gp", along, box[:, 3:])
        outside: Array = (distance + reach < 0).any(axis=1)
        return outside

    def _normals(self) -> Array:
        """[5, 3]: inward normals of the sides and the back; cameras look along -z."""
        half = np.deg2rad(self._model.cam_fovy[self._camera]) / 2
        sine, cosine = np.sin(half), np.cos(half)
        local = np.array(
            [
                (cosine, 0, -sine),
                (-cosine, 0, -sine),
                (0, cosine, -sine),
                (0, -cosine, -sine),
                (0, 0, -1),
            ]
        )
        turn = self._data.cam_xmat[self._camera].reshape(3, 3)
        normals: Array = local @ turn.T
        return normals
