"""How both NutAssembly tasks are solved."""

import numpy as np

from manip.envs.task import Measures
from manip.tasks.experts.motion import towards, upright
from manip.tasks.objects import yaw

Array = np.ndarray


def nut_assembly(m: Measures) -> Array:
    """Take the nut by its handle, carry it over the peg, down a little, and let go."""
    heading = yaw(m["nut_mat"])
    offset = m["to_handle"] + 0.008 * m["nut_mat"][:, [0, 3, 6]]
    turn = np.arctan(np.tan(m["handle_turn"]))
    apart = (np.linalg.norm(offset[:, :2], axis=1) > 0.01) | (np.abs(turn) > 0.15)
    distance, on = np.linalg.norm(offset, axis=1), m["threaded"]
    kept = (m["gripper_closing"] > -0.9) & (distance < 0.03)
    closing = (kept | (distance < 0.008)) & ~on
    offset[:, 2] += np.where(apart & ~closing, 0.05, 0.0)
    carried = closing & m["grasped"] & (m["gripper_closing"] > 0.9)
    offset = np.where(carried[:, None], _along_peg(m), offset) * ~on[:, None]
    action = towards(1.5 * offset, np.where(closing, 1.0, -1.0))
    turn = np.where(carried, _sideways(heading) - heading, turn * ~closing)
    action[:, 3:6] = upright(m["eef_mat"], turn * ~on)
    return action


def _along_peg(m: Measures) -> Array:
    """Up before the peg is near, then across, and down once 5 mm from its axis."""
    far, low = m["aside"] > 0.005, (m["height"] < 0.965) & (m["aside"] < 0.15)
    offset = m["to_peg"] * ~(far & low)[:, None]
    offset[:, 2] = np.where(far, 0.985, 0.9) - m["height"]
    return offset


def _sideways(heading: Array) -> Array:
    """The nearest quarter turn [rad] but straight ahead: there the arm is too short."""
    return np.sign(heading) * np.where(np.abs(heading) < 0.75 * np.pi, 0.5, 1) * np.pi
