"""Versions of everything that a result may depend on."""

import platform
from importlib.metadata import PackageNotFoundError, version

PACKAGES = (
    "manip-suite",
    "mujoco",
    "robosuite",
    "dm_control",
    "torch",
    "torchrl",
    "tensordict",
    "numba",
    "numpy",
)


def versions() -> dict[str, str]:
    """Package -> version, and Python's."""
    installed = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            installed[package] = version(package)
        except PackageNotFoundError:
            installed[package] = "not installed"
    return installed
