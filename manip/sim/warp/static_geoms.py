"""Poses of geoms that are welded to the world, which mujoco_warp computes only once."""

from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from manip.sim.scene import Scene
from manip.sim.warp.device_model import model_slots

POSES = {"body_pos", "body_quat", "geom_pos", "geom_quat"}
"""Arrays of the model that move such geoms."""


@wp.func
def quaternion_matrix(q: wp.quat) -> wp.mat33:
    """Rotation matrix of a quaternion in MuJoCo's order, w first."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return wp.mat33(
        w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z,
    )  # fmt: skip


@wp.kernel(enable_backward=False)
def _pose(
    geoms: wp.array[int],
    geom_body: wp.array[int],
    geom_pos: wp.array2d[wp.vec3],
    geom_quat: wp.array2d[wp.quat],
    xpos: wp.array2d[wp.vec3],
    xmat: wp.array2d[wp.mat33],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
) -> None:
    env, i = wp.tid()
    geom = geoms[i]
    body = geom_body[geom]
    at = geom_pos[env % geom_pos.shape[0], geom]
    turn = quaternion_matrix(geom_quat[env % geom_quat.shape[0], geom])
    geom_xpos[env, geom] = xpos[env, body] + xmat[env, body] * at
    geom_xmat[env, geom] = xmat[env, body] * turn


class StaticGeoms:
    """Pose the geoms that are welded to the world, where fields move them."""

    def __init__(self, scene: Scene, host: mujoco.MjModel) -> None:
        moved = {slot.array for slot in model_slots(scene) if slot} & POSES
        static = np.flatnonzero(host.body_weldid[host.geom_bodyid] == 0)
        self._geoms = wp.array(static.astype(np.int32), dtype=int) if moved else None

    def pose(self, model: Any, data: Any) -> None:
        """Set geom_xpos and geom_xmat of all environments, from the fields."""
        if self._geoms is None:
            return
        mjw.kinematics(model, data)
        wp.launch(
            _pose,
            dim=(data.nworld, len(self._geoms)),
            inputs=[
                *(self._geoms, model.geom_bodyid, model.geom_pos, model.geom_quat),
                *(data.xpos, data.xmat),
            ],
            outputs=[data.geom_xpos, data.geom_xmat],
        )
