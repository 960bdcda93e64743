"""The scripted experts of the NutAssembly tasks."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.motion import (
    GAIN,
    move_action,
    upright_turn,
    wrist_turn,
)
from manip.tasks.rotations import yaw_angle

Array = np.ndarray

AWAY = 0.1
"""Horizontal distance [m] from a handle from which the open hand travels."""
BEFORE_PEGS = 0.1
"""x [m] of the tool from which the arm has room to turn, and no peg is near."""
HIGH = 0.98
"""Height [m] at which the open hand travels. At the pegs the arm does not reach 1 m."""
YAWS = (-0.4, np.pi + 0.4)
"""Least and greatest yaw [rad] of the tool at a handle. From all of them the
turn of `_towards_robot` is within the wrist's range."""


def assemble_nut(m: Measures) -> Array:
    """Grasp the nut at its handle, carry it over the peg, lower and release it."""
    heading = yaw_angle(m["nut_mat"])
    turn = np.arctan(np.tan(m["handle_turn"]))
    return _assemble(m, turn, _quarter_turn(heading) - heading)


def assemble_nuts(m: Measures) -> Array:
    """As `assemble_nut` for the active nut, and from a peg back to the other nut.

    The hand brings each nut to the near side of its peg. On the other sides the arm is
    nearly stretched: its elbow swings past the stretched pose to its limit, and does
    not come back.
    """
    turn = _towards_robot(m)
    across = yaw_angle(m["nut_mat"]) + np.pi / 2
    action = _assemble(m, wrist_turn(m["eef_mat"], across, *YAWS), turn)
    ahead = BEFORE_PEGS - m["eef_pos"][:, 0]
    waits = m["grasped"] & (np.abs(turn) > 0.5)
    action[:, 0] = np.where(waits, np.minimum(action[:, 0], GAIN * ahead), action[:, 0])
    far = np.hypot(*m["to_handle"][:, :2].T) > AWAY
    travels = ~m["grasped"] & (m["threaded"] | far)
    action[:, :3] = np.where(travels[:, None], _leave(m, ahead), action[:, :3])
    return action


def _leave(m: Measures, ahead: Array) -> Array:
    """[n, 3]: the action towards the active nut: back from the peg, then sideways."""
    offset = m["to_handle"].copy()
    offset[:, 0] = np.where(m["threaded"], np.minimum(ahead, 0), offset[:, 0])
    offset[:, 1] *= ~m["threaded"] & (ahead > 0)
    offset[:, 2] = HIGH - m["eef_pos"][:, 2]
    return np.clip(GAIN * offset, -1, 1)


def _assemble(m: Measures, turn: Array, turn_held: Array) -> Array:
    """The action; turn [n] rad: of the open hand; turn_held [n] rad: of a held nut."""
    offset = m["to_handle"] + 0.008 * m["nut_mat"][:, [0, 3, 6]]
    apart = (np.linalg.norm(offset[:, :2], axis=1) > 0.01) | (np.abs(turn) > 0.15)
    distance, on_peg = np.linalg.norm(offset, axis=1), m["threaded"]
    around = (m["gripper_closing"] > -0.9) & (distance < 0.03)
    closing = (around | (distance < 0.008)) & ~on_peg
    offset[:, 2] += np.where(apart & ~closing, 0.05, 0.0)
    carried = closing & m["grasped"] & (m["gripper_closing"] > 0.9)
    offset = np.where(carried[:, None], _to_peg(m), offset) * ~on_peg[:, None]
    action = move_action(1.5 * offset, np.where(closing, 1.0, -1.0))
    turn = np.where(carried, turn_held, turn * ~closing)
    action[:, 3:6] = upright_turn(m["eef_mat"], turn * ~on_peg)
    return action


def _to_peg(m: Measures) -> Array:
    """[n, 3] m: up before the peg is near, across, down once 5 mm from its axis."""
    far, low = m["aside"] > 0.005, (m["height"] < 0.965) & (m["aside"] < 0.15)
    offset = m["to_peg"] * ~(far & low)[:, None]
    offset[:, 2] = np.where(far, 0.985, 0.9) - m["height"]
    return offset


def _quarter_turn(heading: Array) -> Array:
    """[n] rad: the nearest of 90, -90 and 180 degrees; at 0 the arm is too short."""
    return np.sign(heading) * np.where(np.abs(heading) < 0.75 * np.pi, 0.5, 1) * np.pi


def _towards_robot(m: Measures) -> Array:
    """[n] rad: turn that points the handle to the robot, within the wrist's range.

    Of the two hands that lie across the handle, one stands as in the arm's default pose
    once the handle points to the robot, and turns the short way. For the other, only a
    turn to the left, by up to 270 degrees, is within the range.
    """
    heading = yaw_angle(m["nut_mat"])
    turn = np.arctan2(np.sin(heading), -np.cos(heading))
    return np.where((np.cos(m["handle_turn"]) > 0) & (turn < -0.5), np.pi, turn)
