"""The memory of one thread's simulation, as compiled code sees it."""

from typing import NamedTuple

import numpy as np

from manip.compiled import kernel
from manip.sim.libmujoco import mju_copy

Array = np.ndarray


class Segments(NamedTuple):
    """Places whose contents make up a row, in order: addresses and lengths."""

    address: Array
    size: Array


class Sim(NamedTuple):
    """A thread's own MjModel and MjData as addresses, and views of their arrays.

    state: the places of a state row; slots: those of a readings row, which the touches
    follow. gains [2]: kp [1/s^2] and kd [1/s] of the controllers of all K robots.
    command [K, m]: of the grippers, one number an actuator. contacts: the readings of
    the contact sensors, numbers of contacts. peaks [2, K, n]: the largest speed [rad/s]
    of each joint in the present control period, then the largest torque [N m].
    """

    model: int
    data: int
    state: Segments
    slots: Segments
    gains: Array
    command: Array
    qpos: Array
    qvel: Array
    ctrl: Array
    mass: Array
    bias: Array
    cdof: Array
    com: Array
    site_xpos: Array
    site_xmat: Array
    contacts: Array
    peaks: Array


@kernel
def load(row: Array, segments: Segments) -> None:
    """Copy a row to the places of its entries."""
    at = row.ctypes.data
    for k in range(len(segments.size)):
        mju_copy(segments.address[k], at, np.int32(segments.size[k]))
        at += 8 * segments.size[k]  # bytes of a float64


@kernel
def store(row: Array, segments: Segments) -> None:
    """Fill a row from the places of its entries."""
    at = row.ctypes.data
    for k in range(len(segments.size)):
        mju_copy(at, segments.address[k], np.int32(segments.size[k]))
        at += 8 * segments.size[k]
