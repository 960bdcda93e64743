"""Pick and place: carry an object to its quarter of the other bin. robosuite's
`PickPlaceMilk`, `PickPlaceBread`, `PickPlaceCereal` and `PickPlaceCan`.

Success: the object's origin is within its quarter of the bin, at most 10 cm above the
    bin's origin, and more than 4.24 cm from the tool (robosuite's test).
Failure: none; an episode ends by time.
Start: the object upright in the first bin, any yaw, uniform in a rectangle of 29 x 39
    cm less its radius, and clear of the three others, which robosuite places there too,
    before it drops them 10 m beside the bins; arm in its default pose with 0.02 rad
    noise a joint, gripper half open.
Shaped reward, in [0, 1] a step: 0.1 reach + 0.15 grasp + 0.15 lift + 0.25 carry
    + 0.05 over + 0.1 release + 0.2 place. Reach is 1 - tanh(5 d) of the distance d [m]
    from the tool to where the object is to be gripped, and half of that with a gripper
    closed around nothing; grasp rises from 0 to 1 as the gripper is told to close, lift
    over the first 20 cm, and carry is lift times the part of 75 cm by which the object
    has come near its place; these are paid only while both finger pads touch the object
    and the tool is inside its box. Held within 7 cm
    of its place they are paid in full with `over`, and release grows as the gripper
    opens. Let go there all of them are, and place grows to a half as the tool moves
    off, until success makes it 1. (Held, it earns less than 0.8; let go, at least 0.8.)
"""

from typing import ClassVar, NamedTuple

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near, ramp
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import observe_arm, ready, start_qpos
from manip.tasks.experts.pick_place import pick_place
from manip.tasks.objects import PARKED, poses, rotation, scatter, turns, yaw

Array = np.ndarray


class Item(NamedTuple):
    """An object: its measures [m], and where it belongs.

    radius: of the circle kept clear of others. stand: height of its origin above the
    bin's when it is put down (both robosuite/models/assets/objects/*.xml). low, high:
    corners of its box in its own frame. grip: height of the tool above its origin, when
    it holds it. folds: turns that leave the grip as it is; 0 if any does. place [2]:
    middle of its quarter of the bin.
    """

    radius: float
    stand: float
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    grip: float
    folds: int
    place: tuple[float, float]


ITEMS = {
    "Milk": Item(
        radius=0.025,
        stand=0.085,
        low=(-0.020, -0.020, -0.061),
        high=(0.020, 0.020, 0.083),
        grip=0.045,
        folds=4,
        place=(0.0025, 0.1575),
    ),
    "Bread": Item(
        radius=0.03,
        stand=0.045,
        low=(-0.024, -0.020, -0.023),
        high=(0.024, 0.020, 0.025),
        grip=0.0,
        folds=4,
        place=(0.1975, 0.1575),
    ),
    "Cereal": Item(
        radius=0.04,
        stand=0.1,
        low=(-0.050, -0.015, -0.075),
        high=(0.050, 0.015, 0.075),
        grip=0.04,
        folds=2,
        place=(0.0025, 0.4025),
    ),
    "Can": Item(
        radius=0.025,
        stand=0.06,
        low=(-0.025, -0.025, -0.040),
        high=(0.025, 0.025, 0.040),
        grip=0.0,
        folds=0,
        place=(0.1975, 0.4025),
    ),
}
"""What lies in the bin, in the order in which robosuite places it."""

BIN = np.array([0.1, -0.25, 0.8])
"""Origin [m] of the first bin (robosuite/environments/manipulation/pick_place.py)."""
SPREAD = np.array([0.145, 0.195])
"""Half widths [m] of the rectangle in which an object's circle starts (ibid.)."""
QUARTER = np.array([0.0975, 0.1225])
"""Half widths [m] of a quarter of the second bin (ibid.)."""
DEPTH = 0.1
"""Height [m] above the bin's origin, below which an object is in it (ibid.)."""
AWAY = np.arctanh(0.4) / 10
"""Distance [m] of the tool from the object, beyond which it has let it be."""
LIFTED = 0.25
"""Height [m] above the bin's origin for robosuite's full lifting reward (ibid.)."""
ACROSS = 0.03
"""y [m] of the second bin's near wall (robosuite/models/assets/arenas/)."""
OVER = 0.07
"""Offset [m] of an object from its place, each way, below which it is over it."""
CENTRE = np.array([0.1, 0.0, 1.0])
"""Origin [m] of the tool's place and the object's in observations."""


def _sensors(item: str) -> Sensors:
    body, others = f"{item}_main", [name for name in ITEMS if name != item]
    return Sensors(
        bodies={"object": body, **{f"other_{name}": f"{name}_main" for name in others}},
        touches={
            "left_touch": ("left_fingerpad", body),
            "right_touch": ("right_fingerpad", body),
        },
        parked=tuple(f"{name}_main" for name in others),
    )


class PickPlace(Task):
    """Carry `item` to its place; see the module's docstring for the numbers."""

    item: ClassVar[str]
    horizon = 150
    milestone_names = ("near", "grasp", "lift", "across", "over", "place")
    weights: ClassVar[Weights] = {
        "shaped": {
            "reach": 0.1,
            "grasp": 0.15,
            "lift": 0.15,
            "carry": 0.25,
            "over": 0.05,
            "release": 0.1,
            "place": 0.2,
        },
        "stock": {"staged": 0.7, "success": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Place the object; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        spread = {name: SPREAD - item.radius for name, item in ITEMS.items()}
        radius = {name: item.radius for name, item in ITEMS.items()}
        spots = BIN[:2] + scatter(streams, spread, radius)[self.item]
        for name in ITEMS:
            qpos[:, scene.free_qpos(f"{name}_main")] = PARKED
        height = BIN[2] + ITEMS[self.item].stand
        body = scene.free_qpos(f"{self.item}_main")
        qpos[:, body] = poses(streams, spots, height)
        return Start(qpos)

    def measure(self, read: Measures) -> Measures:
        """Add how the object lies to the tool and to its place, and who holds it.

        to_object [N, 3] m from the tool, distance [N] m; to_grip [N, 3] m from the tool
        to where the object is to be gripped; turned [N, 9] the object's rotation;
        to_place [N, 2] m from the object; height [N] m since it stood; grasped [N] is
        robosuite's test, held [N] asks that the tool is inside the object's box, too;
        over, inside [N]: the object is above its place, in its quarter of the bin.
        """
        item = ITEMS[self.item]
        turned, position = rotation(read["object_quat"]), read["object_pos"]
        to_object = position - read["eef_pos"]
        to_place = np.array(item.place) - position[:, :2]
        grasped = (read["left_touch"] > 0) & (read["right_touch"] > 0)
        deep = position[:, 2] - BIN[2]
        inside = (np.abs(to_place) < QUARTER).all(axis=1) & (deep > 0) & (deep < DEPTH)
        return {
            **read,
            "to_object": to_object,
            "distance": _length(to_object),
            "to_grip": to_object + item.grip * turned[:, [2, 5, 8]],
            "turned": turned,
            "to_place": to_place,
            "height": deep - item.stand,
            "grasped": grasped,
            "held": grasped & _in_box(item, turned, -to_object),
            "over": (np.abs(to_place) < OVER).all(axis=1) & (deep > 0),
            "inside": inside,
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and how it is turned, then the object, coarse and fine."""
        tool, flags = m["eef_mat"], ("left_touch", "right_touch", "over", "inside")
        folds = ITEMS[self.item].folds
        turn = {"turn": turns(folds * (yaw(m["turned"]) - yaw(tool)))} if folds else {}
        return {
            **observe_arm(m, CENTRE),
            "tool_yaw": turns(yaw(tool)),
            "tool_tilt": 3.0 * tool[:, [2, 5]],
            "object_pos": 4.0 * (m["object_pos"] - CENTRE),
            "to_grip": 10.0 * np.clip(m["to_grip"], -0.3, 0.3),
            "to_grip_fine": 50.0 * np.clip(m["to_grip"], -0.02, 0.02),
            "to_place": 4.0 * m["to_place"],
            "to_place_fine": 10.0 * np.clip(m["to_place"], -0.1, 0.1),
            **turn,
            "upright": m["turned"][:, 6:],
            "object_linvel": m["object_linvel"],
            "object_angvel": 0.2 * m["object_angvel"],
            "flags": np.stack([m[name] for name in flags], axis=1).astype(float),
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        if reward == "stock":
            return self._stock_terms(m)
        held, arrived = m["held"], m["held"] & m["over"]
        let_go = (m["over"] | m["inside"]) & ~m["grasped"]
        paid = arrived | let_go
        lift = held * ramp(m["height"], 0.0, 0.2)
        nearer = ramp(-_length(m["to_place"]), -0.75, 0.0)
        opening = ramp(-m["gripper_closing"], -1.0, 1.0)
        reach = ready(m) * near(_length(m["to_grip"]), 0.2)
        away = np.where(self.success(m), 1.0, 0.5 * ramp(m["distance"], 0.0, AWAY))
        return {
            "reach": np.maximum(let_go, reach),
            "grasp": np.maximum(paid, held * ramp(m["gripper_closing"], -1.0, 1.0)),
            "lift": np.maximum(paid, lift),
            "carry": np.maximum(paid, lift * nearer),
            "over": paid.astype(float),
            "release": np.maximum(let_go, arrived * opening),
            "place": let_go * away,
        }

    def _stock_terms(self, m: Measures) -> dict[str, Array]:
        """The largest of robosuite's milestones; to lift, it takes the highest object."""
        lift = m["grasped"] * (0.35 + 0.15 * near(_below(m), 1 / 15))
        over = (np.abs(m["to_place"]) < QUARTER).all(axis=1)
        hover = np.where(over, 0.5, lift) + 0.2 * near(_length(m["to_place"]), 0.1)
        staged = np.maximum(0.1 * near(m["distance"], 0.1), hover)
        return {
            "staged": ~self.success(m) * staged / 0.7,
            "success": self.success(m).astype(float),
        }

    def success(self, m: Measures) -> Array:
        """The object is in its quarter of the bin, and the tool away from it."""
        return m["inside"] & (m["distance"] > AWAY)

    def expert(self, m: Measures) -> Array:
        """As `manip.tasks.experts.pick_place`."""
        return pick_place(m, BIN, ITEMS[self.item].folds)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 3 cm of the grip; lift: by 10 cm; across: the bins' gap."""
        lifted = m["held"] & (m["height"] > 0.1)
        return {
            "near": _length(m["to_grip"]) < 0.03,
            "grasp": m["held"],
            "lift": lifted,
            "across": lifted & (m["object_pos"][:, 1] > ACROSS),
            "over": m["held"] & m["over"],
            "place": self.success(m),
        }


class PickPlaceMilk(PickPlace):
    """The milk carton."""

    robosuite_name = "PickPlaceMilk"
    item = "Milk"
    sensors = _sensors("Milk")


class PickPlaceBread(PickPlace):
    """The loaf of bread."""

    robosuite_name = "PickPlaceBread"
    item = "Bread"
    sensors = _sensors("Bread")


class PickPlaceCereal(PickPlace):
    """The cereal box, which fits between the fingers one way only."""

    robosuite_name = "PickPlaceCereal"
    item = "Cereal"
    sensors = _sensors("Cereal")


class PickPlaceCan(PickPlace):
    """The can."""

    robosuite_name = "PickPlaceCan"
    item = "Can"
    sensors = _sensors("Can")


def _length(offset: Array) -> Array:
    return np.linalg.norm(offset, axis=1)


def _in_box(item: Item, turned: Array, offset: Array) -> Array:
    """[N] bool: `offset` [N, 3] m from the object's origin is inside its box."""
    local = np.einsum("nij,ni->nj", turned.reshape(-1, 3, 3), offset)
    return ((local > item.low) & (local < item.high)).all(axis=1)


def _below(m: Measures) -> Array:
    """[N] m: how far the highest of all objects is below robosuite's lifting height."""
    names = [name for name in m if name.startswith("other_") and name.endswith("_pos")]
    top = np.max([m[name][:, 2] for name in ("object_pos", *names)], axis=0)
    return np.maximum(BIN[2] + LIFTED - top, 0.0)
