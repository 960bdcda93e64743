"""Drop the contacts that MuJoCo Warp's box-box collider invents.

The analytic collider finds the contacts of C's, which the default one (CCD) partly
misses. But in float32 it breaks a tie between axes wrongly on some pairs of flat boxes
and returns contacts up to 0.5 m deep (54 of 586 pairs of NutAssembly's). A contact
cannot be deeper than the thinner box is thick.
"""

from typing import Any

import mujoco_warp as mjw
import warp as wp

BOX = wp.constant(int(mjw.GeomType.BOX))

NO_CONTACT = wp.constant(1.0)
"""Distance [m] of a dropped contact: beyond every margin."""


@wp.kernel(enable_backward=False)
def _drop(
    geom_type: wp.array[int],
    geom_size: wp.array2d[wp.vec3],
    nacon: wp.array[int],
    geoms: wp.array[wp.vec2i],
    env_ids: wp.array[int],
    dist: wp.array[float],
    kind: wp.array[int],
) -> None:
    i = wp.tid()
    if i >= nacon[0]:
        return
    a, b = geoms[i][0], geoms[i][1]
    if a < 0 or b < 0 or geom_type[a] != BOX or geom_type[b] != BOX:
        return
    env = env_ids[i] % geom_size.shape[0]
    half = wp.min(wp.min(geom_size[env, a]), wp.min(geom_size[env, b]))
    if dist[i] < -2.0 * half:
        dist[i] = NO_CONTACT
        kind[i] = 0


def drop_ghost_contacts(model: Any, data: Any) -> None:
    """A contact filter, as mujoco_warp's `Model.callback.contactfilter` expects."""
    contact = data.contact
    wp.launch(
        _drop,
        dim=data.naconmax,
        inputs=[model.geom_type, model.geom_size, data.nacon, contact.geom],
        outputs=[contact.worldid, contact.dist, contact.type],
    )
