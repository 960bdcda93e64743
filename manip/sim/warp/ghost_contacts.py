"""Drop the contacts that MuJoCo Warp's box-box collider invents.

The analytic collider finds the contacts of C's, which the default one (CCD) partly
misses. But in float32 it breaks a tie between axes wrongly on some pairs of flat boxes
and returns contacts up to 0.5 m deep (54 of 586 pairs of NutAssembly's). By the
separating axis theorem, two boxes are no deeper in one another than they overlap along
any axis: a contact that is deeper than the overlap along a face's normal is none.
"""

from typing import Any

import mujoco_warp as mjw
import warp as wp

BOX = wp.constant(int(mjw.GeomType.BOX))

NO_CONTACT = wp.constant(1.0)
"""Distance [m] of a dropped contact: beyond every margin."""

ROUNDING = wp.constant(1e-5)
"""By so much [m] a contact may be deeper."""


@wp.func
def least_overlap(
    p: wp.vec3, r: wp.mat33, half: wp.vec3, q: wp.vec3, s: wp.mat33, other: wp.vec3
) -> float:
    """Least overlap [m] of two boxes along the axes of the first one.

    p, r, half: position, rotation and half sizes; q, s, other: those of the second.
    """
    between = wp.transpose(r) * (q - p)
    turn = wp.transpose(r) * s
    least = half[0] + wp.length(other)  # no box overlaps by more along its first axis
    for i in range(3):
        reach = half[i]
        for j in range(3):
            reach = reach + wp.abs(turn[i, j]) * other[j]
        least = wp.min(least, reach - wp.abs(between[i]))
    return least


@wp.kernel(enable_backward=False)
def _drop(
    geom_type: wp.array[int],
    geom_size: wp.array2d[wp.vec3],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
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
    env = env_ids[i]
    row = env % geom_size.shape[0]
    p, q = geom_xpos[env, a], geom_xpos[env, b]
    r, s = geom_xmat[env, a], geom_xmat[env, b]
    half, other = geom_size[row, a], geom_size[row, b]
    least = wp.min(
        least_overlap(p, r, half, q, s, other), least_overlap(q, s, other, p, r, half)
    )
    if -dist[i] > least + ROUNDING:
        dist[i] = NO_CONTACT
        kind[i] = 0


def drop_ghost_contacts(model: Any, data: Any) -> None:
    """A contact filter, as mujoco_warp's `Model.callback.contactfilter` expects."""
    contact = data.contact
    wp.launch(
        _drop,
        dim=data.naconmax,
        inputs=[
            *(model.geom_type, model.geom_size, data.geom_xpos, data.geom_xmat),
            *(data.nacon, contact.geom, contact.worldid),
        ],
        outputs=[contact.dist, contact.type],
    )
