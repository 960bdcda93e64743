"""libmujoco's C functions as callees of compiled code: no struct offsets, no build."""

from pathlib import Path
from typing import Any

import llvmlite.binding
import mujoco
from numba import types

_LIBRARY = next(Path(mujoco.__file__).parent.glob("libmujoco*"), None)
if _LIBRARY is None:
    raise ImportError(f"no libmujoco beside {mujoco.__file__}: reinstall mujoco")
llvmlite.binding.load_library_permanently(str(_LIBRARY))


def _function(name: str, *arguments: Any) -> types.ExternalFunction:
    return types.ExternalFunction(name, types.void(*arguments))


_pointer, _int = types.intp, types.int32
mj_step1 = _function("mj_step1", _pointer, _pointer)
mj_step2 = _function("mj_step2", _pointer, _pointer)
mj_forward = _function("mj_forward", _pointer, _pointer)
mju_copy = _function("mju_copy", _pointer, _pointer, _int)
