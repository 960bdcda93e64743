"""Look up objects of a MuJoCo model by name."""

import mujoco

from manip.errors import unknown


def lookup(model: mujoco.MjModel, kind: str, name: str) -> int:
    """Id of a named body, site, geom, ... of the model.

    Raises:
        UserError: no such name; the message lists the names that exist.
    """
    found = find(model, kind, name)
    if found < 0:
        count = model.njnt if kind == "joint" else getattr(model, f"n{kind}")
        known = (getattr(model, kind)(i).name for i in range(count))
        raise unknown(kind, name, filter(None, known))
    return found


def find(model: mujoco.MjModel, kind: str, name: str) -> int:
    """Id of a named body, site, geom, ..., or -1."""
    return mujoco.mj_name2id(
        model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name
    )
