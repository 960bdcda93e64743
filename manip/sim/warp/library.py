"""The libraries of the extra `gpu`, and the device that they compute on."""

import importlib
from typing import Literal, get_args

from manip.errors import UserError, check_choice

Device = Literal["cuda", "cpu"]
"""cuda: an NVIDIA GPU; cpu: the same kernels on one core, to try and to test them."""

INSTALL = "pip install --no-deps mujoco-warp==3.8.1 warp-lang==1.13.0 (the extra `gpu`)"


def check_library(device: str) -> None:
    """Check that MuJoCo Warp is installed and has the device.

    Raises:
        UserError: a package is missing, or there is no such device.
    """
    check_choice("device", device, get_args(Device))
    try:
        warp = importlib.import_module("warp")
        warp.config.quiet = True
        importlib.import_module("mujoco_warp")
    except ImportError as error:
        raise UserError(
            f"the engine warp needs the package {error.name}: {INSTALL}"
        ) from None
    if device == "cuda" and not warp.is_cuda_available():
        raise UserError(
            "the device cuda needs an NVIDIA GPU with its driver, and warp finds none: "
            "--device cpu runs the same kernels on one core, slowly; --engine native "
            "is the fast engine for CPUs"
        )
