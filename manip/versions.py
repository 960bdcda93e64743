"""Versions of everything that a result may depend on."""

import os
import platform
from functools import cache
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
    return dict(_installed())


@cache
def _installed() -> dict[str, str]:
    installed = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            installed[package] = version(package)
        except PackageNotFoundError:
            installed[package] = "not installed"
    return installed


def differences(expected: dict[str, str]) -> str:
    """What this machine has in other versions, in a line; empty if all are equal."""
    here = versions()
    changed = [
        f"{package} {here.get(package)}, not {version}"
        for package, version in expected.items()
        if here.get(package) != version
    ]
    if not changed:
        return ""
    return f"node {os.uname().nodename} has {'; '.join(changed)}: install the same"
