"""Look up objects of a MuJoCo model by name."""

import mujoco

from manip.errors import unknown

_COUNTS = {"joint": "njnt", "actuator": "nu", "camera": "ncam", "material": "nmat"}
"""Kind of object -> size in MjModel, where it is not called n<kind>."""


def lookup(model: mujoco.MjModel, kind: str, name: str) -> int:
    """Id of a named body, site, geom, ... of the model.

    Raises:
        UserError: no such name; the message lists the names that exist.
    """
    index = find(model, kind, name)
    if index < 0:
        count = getattr(model, _COUNTS.get(kind, f"n{kind}"))
        known = (getattr(model, kind)(i).name for i in range(count))
        raise unknown(kind, name, filter(None, known))
    return index


def find(model: mujoco.MjModel, kind: str, name: str) -> int:
    """Id of a named body, site, geom, ..., or -1."""
    if not isinstance(name, str):
        return -1  # MuJoCo would end the process
    return mujoco.mj_name2id(
        model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name
    )
