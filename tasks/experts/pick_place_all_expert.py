"""The scripted expert of PickPlace, which moves four objects one after the other."""

import numpy as np

from manip.envs.task import Measures
from manip.rewards.kernels import ramp
from manip.tasks.experts.motion import GAIN, upright_turn, wrist_turn
from manip.tasks.experts.pick_place_expert import move_object
from manip.tasks.pick_place_measures import WALL
from manip.tasks.rotations import yaw_angle

Array = np.ndarray

BASE = np.array([-0.5, -0.1, 0.0])
"""Position [m] of the robot
(robosuite/models/robots/manipulators/panda_robot.py, base_xpos_offset)."""
LONG = (0.72, 0.84)
"""Horizontal distances [m] of the tool from the robot between which the hand leans
back, up to `MOST_LEAN`."""
MOST_LEAN = 0.45
"""Greatest lean [rad]. An upright hand needs a stretched arm there, of which the elbow
swings to its limit, and does not come back."""
TILTING = 0.3
"""Greatest action that tilts the hand: a fast change of the lean swings the elbow."""
AWAY = 0.1
"""Horizontal distance [m] from the grip from which the open hand travels."""
HIGH = 1.02
"""Height [m] at which it travels, above the objects in the second bin."""
NEARER = np.array([0.035, 0.045])
"""Distance [m], along x and y, from the spot to which an object is carried to the
centre of its place."""
CARRY = 0.18
"""Height [m] above where it stood at which an object is carried above the others."""
BLOCKED = 0.08
"""Height [m] above where it stood below which an object is released if it cannot be
lowered further, because a finger rests on a wall."""
LEFT = 0.12
"""Distance [m] of the hand from the grip from which a released object that is not in
place is grasped again."""
DIRECTIONS = 4
"""Directions of the fingers that are compared."""
YAWS = (0.5, np.pi + 0.6)
"""Least and greatest yaw [rad] of the tool at an object, within the wrist's range."""
FINGER = 0.055
"""Distance [m] of an open finger from the object's axis."""
PALM = 0.1
"""Half width [m] of the palm, along which the fingers move."""
WALLS = np.array([0.19, 0.24])
"""Distances [m] of the first bin's inner walls from its centre
(robosuite/models/assets/arenas/bins_arena.xml)."""
BIN_WALL = 0.9
"""Height [m] of the top of the bins' walls (ibid.); the palm is 4 cm above the tool."""
SLACK = 0.013
"""Greatest distance [m] from an object to the middle between the open fingers."""
RADIUS = 0.035
"""Radius [m] of the circle around another object that fingers stay out of."""
ENOUGH = 0.02
"""Room [m] of the fingers beyond which more is of no use."""


def pick_and_place_all(m: Measures, bin_centre: Array) -> Array:
    """As `pick_and_place` for the active object, above and between the others."""
    m = {**m, "to_grip": m["to_grip"] + _from_walls(m, bin_centre)}
    offset, rise = m["to_grip"].copy(), HIGH - m["eef_pos"][:, 2]
    turn, near = _free_turn(m, bin_centre), np.linalg.norm(offset, axis=1) < LEFT
    action = move_object(m, turn, _over_others(m), _lowered(m), near)
    far = np.hypot(*offset[:, :2].T) > AWAY
    travels = far & ~m["grasped"] & ~m["finished"]
    offset[:, :2] *= (rise < 0.05)[:, None]
    offset[:, 2] = rise
    move = np.clip(GAIN * offset, -1, 1)
    lean = _lean(m) - _along_fingers(m) * (~far & ~m["grasped"])[:, None]
    tilt = upright_turn(m["eef_mat"], 0 * rise, lean)[:, :2]
    action[:, 3:5] = np.clip(tilt, -TILTING, TILTING)
    action[:, :3] = np.where(travels[:, None], move, action[:, :3])
    action[:, 6] = np.where(travels, -1.0, action[:, 6])
    return action


def _lean(m: Measures) -> Array:
    """[n, 3]: how far the tool points away from the robot, where the arm is long."""
    out = (m["eef_pos"] - BASE) * [1, 1, 0]
    reach = np.linalg.norm(out, axis=1)
    lean = MOST_LEAN * ramp(reach, *LONG)
    return (lean / reach)[:, None] * out


def _along_fingers(m: Measures) -> Array:
    """[n, 3]: the part of the lean in the plane in which the fingers close."""
    axis = m["eef_mat"][:, [0, 3, 6]]
    return (_lean(m) * axis).sum(axis=1, keepdims=True) * axis


def _over_others(m: Measures) -> Array:
    """[n, 3] m: up above the other objects, along x, then along y, and down."""
    offset, height = m["to_place"] - NEARER, m["height"]
    there = np.linalg.norm(offset, axis=1) < 0.05
    high = there | (height > CARRY - 0.03)
    aligned = there | (np.abs(offset[:, 0]) < 0.05) | (m["object_pos"][:, 1] > WALL)
    offset *= np.column_stack([high, high & aligned])
    down = np.where(there, -0.5 * height - 0.01, CARRY - height)
    return np.column_stack([offset, down])


def _lowered(m: Measures) -> Array:
    """[n] bool: a carried object is down, or nearly and stays there."""
    still = np.abs(m["joint_vel"]).max(axis=1) < 0.1
    return (m["height"] < 0.03) | (still & (m["height"] < BLOCKED))


def _free_turn(m: Measures, bin_centre: Array) -> Array:
    """[n] rad: turn of the tool to the yaw at which its fingers have the most room."""
    turns = np.stack([_turn_to(m, number) for number in range(DIRECTIONS)], axis=1)
    yaw = yaw_angle(m["eef_mat"])[:, None] + turns
    room = np.minimum(_room(m, yaw, bin_centre), ENOUGH)
    allowed = np.arange(DIRECTIONS) % _spacing(m["symmetry"])[:, None] == 0
    cost = 0.01 * np.abs(turns) + _radial(m, yaw)
    best = np.where(allowed, room - cost, -np.inf).argmax(axis=1)
    return turns[np.arange(len(best)), best]


def _from_walls(m: Measures, bin_centre: Array) -> Array:
    """[n, 3] m: shift of the open hand along its fingers: the palm clears the walls.

    The object then is nearer to one of the fingers.
    """
    axis = m["eef_mat"][:, None, [0, 3]] * [[1.0], [-1.0]]
    ends = m["object_pos"][:, None, :2] + PALM * axis
    beyond = (np.abs(ends - bin_centre[:2]) - WALLS).max(axis=2).clip(0.0, SLACK)
    needed = (_low(m) & ~m["grasped"])[:, None]
    shift = -(beyond[:, :, None] * axis).sum(axis=1) * needed
    return np.column_stack([shift, np.zeros(len(shift))])


def _low(m: Measures) -> Array:
    """[n] bool: at the active object's grip, the palm is as low as the walls."""
    low: Array = m["object_pos"][:, 2] < BIN_WALL - 0.05
    return low


def _radial(m: Measures, yaw: Array) -> Array:
    """[n, k] m: cost of tool yaws [n, k] at which the hand closes in its leaning plane.

    The sides of an object then are not parallel to the fingers.
    """
    out = (m["object_pos"] - BASE)[:, :2]
    angle = yaw - np.arctan2(out[:, 1], out[:, 0])[:, None]
    long = ramp(np.linalg.norm(out, axis=1), *LONG)
    return 0.05 * np.abs(np.cos(angle)) * long[:, None]


def _turn_to(m: Measures, number: int) -> Array:
    """[n] rad: turn of the tool to direction `number` of `DIRECTIONS`."""
    first = yaw_angle(m["object_mat"]) * (m["symmetry"] > 0) + np.pi / 2
    return wrist_turn(m["eef_mat"], first + np.pi * number / DIRECTIONS, *YAWS)


def _spacing(symmetry: Array) -> Array:
    """[n] int: how many directions lie between those in which objects are alike."""
    return np.where(symmetry > 0, 2 * DIRECTIONS // np.maximum(symmetry, 1), 1)


def _room(m: Measures, yaw: Array, bin_centre: Array) -> Array:
    """[n, k] m: room of the open fingers at tool yaws [n, k], to objects and walls.

    At a low object, the palm is as low as the walls, and needs room, too.
    """
    centre = m["object_pos"][:, None, None, :2]
    along = np.stack([np.cos(yaw), np.sin(yaw)], axis=2)[:, :, None] * [[1.0], [-1.0]]
    gap = (centre + FINGER * along)[:, :, :, None] - m["all_pos"][:, None, None, :, :2]
    others = np.arange(gap.shape[3]) != m["active"][:, None]
    distance = np.linalg.norm(gap, axis=4) - RADIUS
    distance = np.where(others[:, None, None], distance, np.inf).min(axis=3)
    width = np.where(_low(m), PALM, FINGER)
    ends = centre + width[:, None, None, None] * along
    wall = (WALLS - np.abs(ends - bin_centre[:2])).min(axis=3)
    return np.minimum(distance, wall).min(axis=2)
