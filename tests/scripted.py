"""Scripted policies: a few lines that solve a task, as proof that it can be solved.

Each maps measures [N, ...] to OSC_POSE actions [N, A] and remembers nothing.
"""

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scripted_hang import tool_hang

from manip.envs.registry import task_names
from manip.envs.task import Measures
from manip.rewards.kernels import ramp
from tasks.objects import rotation, yaw
from tasks.pick_place import BIN
from tasks.scenes.cube import HALF
from tasks.stack import STACKED

Array = np.ndarray

GAIN = 20.0
"""Action for a metre of distance: full speed from 5 cm on."""
SPIN = 4.0
"""Action for a radian: full speed from 0.25 rad on."""
UP = np.array([0.0, 0.0, 1.0])


def reach(m: Measures) -> Array:
    """Straight to the goal."""
    return _towards(m["to_goal"], np.ones(len(m["to_goal"])))


def lift(m: Measures) -> Array:
    """Grasp the cube, and up."""
    return _take_cube(m, then=np.tile([0.0, 0.0, 0.1], (len(m["to_cube"]), 1)))


def pick_goal(m: Measures) -> Array:
    """Grasp the cube, and straight to the goal."""
    return _take_cube(m, then=m["to_goal"])


def push(m: Measures) -> Array:
    """Grasp the cube, and drag it over the table to the goal."""
    return _take_cube(m, then=np.column_stack([m["to_goal"], HALF - m["height"]]))


def _take_cube(m: Measures, then: Array) -> Array:
    """Above the cube, down to it, close for good; `then` move once both pads touch."""
    offset = m["to_cube"].copy()
    aside = np.linalg.norm(offset[:, :2], axis=1)
    at_cube = m["distance"] < 0.012
    closing = at_cube | (m["gripper_closing"] > 0.1) | m["grasped"]
    offset[:, 2] += np.where(aside > 0.01, 0.06, 0.0) * ~closing
    offset[m["grasped"]] = then[m["grasped"]]
    return _towards(offset, np.where(closing, 1.0, -1.0))


def stack(m: Measures) -> Array:
    """Around A as it is turned, close, up, over B, down, and open once it rests."""
    offset, turn = m["to_a"].copy(), _quarter(yaw(rotation(m["a_quat"])), m)
    apart = (np.linalg.norm(offset[:, :2], axis=1) > 0.01) | (np.abs(turn) > 0.1)
    kept = m["grasped"] | ((m["distance"] < 0.02) & (m["gripper_closing"] > 0.1))
    closing = (kept | (m["distance"] < 0.012)) & ~m["on"]
    offset[:, 2] += np.where(apart & ~closing, 0.06, 0.0)
    carried = m["grasped"] & (m["gripper_closing"] > 0.9)
    offset = np.where(carried[:, None], _onto(-m["from_b"] + STACKED * UP), offset)
    leave = np.where(m["gripper_closing"] < -0.5, 0.1, 0.0)[:, None] * UP
    offset = np.where(m["on"][:, None], leave, offset)
    action = _towards(offset, np.where(closing, 1.0, -1.0))
    action[:, 5] = np.clip(SPIN * turn, -1, 1) * ~m["on"]
    return action


def _onto(offset: Array) -> Array:
    """3 cm above the place, then down once it is less than 8 mm aside."""
    aside, below = np.linalg.norm(offset[:, :2], axis=1), offset[:, 2]
    down = (aside < 0.008) | ((aside < 0.015) & (below > -0.025))
    offset[:, :2] *= (below < -0.015)[:, None] | down[:, None]
    offset[:, 2] = np.where(down, below - 0.005, below + 0.03)
    return offset


def _quarter(angle: Array, m: Measures) -> Array:
    """Smallest turn [rad] of the tool that brings it to `angle`, give or take 90°."""
    error = angle - yaw(m["eef_mat"])
    return error - np.pi / 2 * np.round(error / (np.pi / 2))


def pick_place(m: Measures, folds: int) -> Array:
    """Take the object as it is turned, carry it over its place, down, and let go."""
    offset, grip = m["to_grip"].copy(), m["gripper_closing"]
    turn = _clear_of_walls(m, folds) if folds else np.zeros(len(grip))
    aside = np.linalg.norm(offset[:, :2], axis=1)
    apart = (aside > 0.01 + 0.01 * ramp(offset[:, 2], -0.05, 0.0)) | (abs(turn) > 0.1)
    still = (np.abs(m["joint_vel"]).max(axis=1) < 0.1) & (offset[:, 2] > -0.03)
    at_grip = (np.linalg.norm(offset, axis=1) < 0.012) | (still & ~apart)
    letting = m["over"] & (~m["grasped"] | (m["height"] < 0.03) | (grip < 0.9))
    closing = (m["grasped"] | at_grip | (~apart & (grip > -0.9))) & ~letting
    offset[:, 2] += np.where(apart & ~closing, 0.07, 0.0)
    carried = m["grasped"] & (grip > 0.9)
    offset = np.where(carried[:, None], _across(m), offset)
    leave = np.where(m["grasped"], 0.0, 0.1)[:, None] * UP
    offset = np.where(letting[:, None], leave, offset)
    action = _towards(offset, np.where(closing, 1.0, -1.0))
    action[:, 3:6] = _upright(m["eef_mat"], turn * ~closing * ~letting)
    return action


def _clear_of_walls(m: Measures, folds: int) -> Array:
    """Turn [rad] of the tool that lays the fingers along the wider gap to the walls."""
    gap = [0.2, 0.25] - np.abs(m["object_pos"][:, :2] - BIN[:2])
    wide, period = np.pi / 2 * (gap[:, 1] > gap[:, 0]), 2 * np.pi / folds
    angle = yaw(m["turned"]) + np.pi / 2
    angle += period * np.round((wide - angle) / period)
    turn = angle - yaw(m["eef_mat"])
    return turn - np.pi * np.round(turn / np.pi)


def _across(m: Measures) -> Array:
    """12 cm up before the wall, across, and down less than 5 cm from its place."""
    there = np.linalg.norm(m["to_place"], axis=1) < 0.05
    clear = there | (m["height"] > 0.09) | (m["object_pos"][:, 1] < -0.12)
    down = np.where(there, 0.0, 0.12) - m["height"]
    return np.column_stack([m["to_place"] * clear[:, None], down])


def door(m: Measures) -> Array:
    """Over the handle and around it, close, turn it down, pull, and hold it open."""
    panel = Rotation.from_quat(m["door_quat"], scalar_first=True).as_matrix()
    along, out = panel[:, :, 0], -panel[:, :, 1]
    offset = m["to_handle"] + 0.015 * out
    kept = (m["gripper_closing"] > 0.1) & (m["distance"] < 0.1)
    closing = kept | (np.linalg.norm(offset, axis=1) < 0.02)
    offset = np.where(closing[:, None], offset, _over(offset, out))
    angle, ajar = m["handle"][:, None], m["hinge"][:, None]
    turn = -0.1 * (np.sin(angle) * along + np.cos(angle) * UP)
    pull = np.clip(0.37 - ajar, -0.1, 0.1) * out
    work = 0.5 * offset + np.where((angle > 1.25) | (ajar > 0.1), pull, turn)
    shut = m["gripper_closing"][:, None] > 0.9
    action = _towards(np.where(shut, work, offset), np.where(closing, 1.0, -1.0))
    action[:, 3:6] = _lean(m["eef_mat"], out)
    return action


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
    action = _towards(1.5 * offset, np.where(closing, 1.0, -1.0))
    turn = np.where(carried, _sideways(heading) - heading, turn * ~closing)
    action[:, 3:6] = _upright(m["eef_mat"], turn * ~on)
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


def _upright(eef_mat: Array, turn: Array) -> Array:
    """Turn the tool's axis downwards, and the tool by `turn` [n] rad about it."""
    tilt = np.cross(eef_mat[:, [2, 5, 8]], -UP)
    return np.clip(SPIN * (tilt + turn[:, None] * UP), -1, 1)


def wipe(m: Measures) -> Array:
    """Above the nearest dirt, down on it once 3 cm aside, and on to the next."""
    offset = m["nearest"].copy()
    over = np.linalg.norm(offset[:, :2], axis=1) < 0.03
    offset[:, 2] += np.where(over, -0.004, 0.03)
    still = np.zeros(len(offset))
    move = _towards(offset, still)[:, :3]
    return np.hstack([move, _upright(m["eef_mat"], still)])


def _over(offset: Array, out: Array) -> Array:
    """8 cm above the handle until it is below; 10 cm before it while too low."""
    aside = np.linalg.norm(offset[:, :2], axis=1, keepdims=True)
    offset = offset + np.where(aside > 0.03, 0.08, 0.0) * UP
    low = (aside > 0.05) & (offset[:, 2:] > 0.035)
    return offset + np.where(low, 0.1, 0.0) * out


def _lean(eef_mat: Array, out: Array) -> Array:
    """Turn the fingers across the handle, the hand leaning 0.3 rad off the door."""
    tool = eef_mat.reshape(-1, 3, 3)
    fingers = np.cos(0.3) * out - np.sin(0.3) * UP
    approach = -np.sin(0.3) * out - np.cos(0.3) * UP
    error = np.cross(tool[:, :, 0], fingers) + np.cross(tool[:, :, 2], approach)
    return np.clip(SPIN / 2 * error, -1, 1)


def _towards(offset: Array, grip: Array) -> Array:
    still = np.zeros((len(offset), 3))
    return np.concatenate([np.clip(GAIN * offset, -1, 1), still, grip[:, None]], axis=1)


SCRIPTS = {
    "Door": door,
    "Lift": lift,
    "NutAssemblyRound": nut_assembly,
    "NutAssemblySquare": nut_assembly,
    "PickGoal": pick_goal,
    "PickPlaceBread": partial(pick_place, folds=4),
    "PickPlaceCan": partial(pick_place, folds=0),
    "PickPlaceCereal": partial(pick_place, folds=2),
    "PickPlaceMilk": partial(pick_place, folds=4),
    "Push": push,
    "Reach": reach,
    "Stack": stack,
    "ToolHang": tool_hang,
    "Wipe": wipe,
}

LONG = {"ToolHang"}
"""Tasks whose scripts take hundreds of steps, for the slow tests."""

TASKS = [
    pytest.param(name, marks=pytest.mark.slow) if name in LONG else name
    for name in task_names()
]
"""Names of all tasks, as parameters of a fixture."""
