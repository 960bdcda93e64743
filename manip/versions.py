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
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found
