"""The scripted expert of both NutAssembly tasks."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.motion import move_action, upright_turn
from manip.tasks.rotations import yaw_angle

Array = np.ndarray


def assemble_nut(m: Measures) -> Array:
    """Grasp the nut at its handle, carry it over the peg, lower and release it."""
    heading = yaw_angle(m["nut_mat"])
    offset = m["to_handle"] + 0.008 * m["nut_mat"][:, [0, 3, 6]]
    turn = np.arctan(np.tan(m["handle_turn"]))
    apart = (np.linalg.norm(offset[:, :2], axis=1) > 0.01) | (np.abs(turn) > 0.15)
    distance, on_peg = np.linalg.norm(offset, axis=1), m["threaded"]
    around = (m["gripper_closing"] > -0.9) & (distance < 0.03)
    closing = (around | (distance < 0.008)) & ~on_peg
    offset[:, 2] += np.where(apart & ~closing, 0.05, 0.0)
    carried = closing & m["grasped"] & (m["gripper_closing"] > 0.9)
    offset = np.where(carried[:, None], _to_peg(m), offset) * ~on_peg[:, None]
    action = move_action(1.5 * offset, np.where(closing, 1.0, -1.0))
    turn = np.where(carried, _quarter_turn(heading) - heading, turn * ~closing)
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
