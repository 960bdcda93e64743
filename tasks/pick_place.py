"""Carry an object to its quarter of the other bin. robosuite's
`PickPlaceMilk`, `PickPlaceBread`, `PickPlaceCereal` and `PickPlaceCan`.

Success: the object's origin is within its quarter of the bin, at most 10 cm above the
    bin's origin, and more than 4.24 cm from the tool (robosuite's test).
Failure: none; an episode ends by its time limit.
Start: the object upright in the first bin, any yaw, uniform in a rectangle of 29 x 39
    cm less its radius, and clear of the three other objects. robosuite places these
    there as well, before it drops them 10 m beside the bins. Arm in its default pose
    with 0.02 rad noise per joint, gripper half open.
Shaped reward, in [0, 1] per step: see `pick_place_rewards`.
"""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Waypoint, Weights
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks import pick_place_rewards as rewards
from manip.tasks.arm import (
    ARM_PARTS,
    TOOL_PARTS,
    observe_arm_and_tool,
    start_qpos,
)
from manip.tasks.experts.pick_place_expert import pick_and_place
from manip.tasks.object_measures import object_measures
from manip.tasks.object_task import ObjectTask
from manip.tasks.offsets import coarse, fine
from manip.tasks.pick_place_items import BIN, ITEMS, standing, start_spots
from manip.tasks.pick_place_measures import WALL, measure_object
from manip.tasks.pick_place_waypoints import NAMES, place_object, stand_in_place
from manip.tasks.placement import PARKED
from manip.tasks.rotations import cos_sin, yaw_angle

Array = np.ndarray

CENTRE = np.array([0.1, 0.0, 1.0])
"""Origin [m] of the observed positions of tool and object."""


def object_sensors(item: str) -> Sensors:
    """What is read of an object."""
    body = f"{item}_main"
    return Sensors(
        bodies={"object": body},
        touches={
            "left_touch": ("left_fingerpad", body),
            "right_touch": ("right_fingerpad", body),
        },
    )


def _sensors(item: str) -> Sensors:
    own, others = object_sensors(item), [name for name in ITEMS if name != item]
    parked = {f"other_{name}": f"{name}_main" for name in others}
    bodies = {**own.bodies, **parked}
    return replace(own, bodies=bodies, parked=tuple(parked.values()))


class OneObject(ObjectTask):
    """Carry `item` to its place; see the module's docstring for the numbers."""

    item: ClassVar[str]
    proprioception = (*ARM_PARTS, *TOOL_PARTS)
    horizon = 150
    milestone_names = ("near", "grasp", "lift", "across", "over", "place")
    waypoint_names = NAMES
    weights: ClassVar[Weights] = rewards.WEIGHTS

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the object's pose; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        spots = start_spots(streams)[self.item]
        for name in ITEMS:
            qpos[:, scene.free_qpos(f"{name}_main")] = PARKED
        body = scene.free_qpos(self.body)
        qpos[:, body] = standing(streams, self.item, spots)
        return Start(qpos)

    def place_in_hand(
        self, milestone: str, scene: Scene, streams: EpisodeStreams, start: Start
    ) -> Waypoint:
        """See `manip.tasks.pick_place_waypoints`."""
        body = scene.free_qpos(self.body)
        return place_object(self.item, milestone, streams, start, body)

    def sample_rest(self, streams: EpisodeStreams) -> Array:
        """[n, 7]: qpos of the object that stands in its quarter of the bin."""
        return stand_in_place(self.item, streams)

    def measure(self, read: Measures) -> Measures:
        """See `measure_object`."""
        return measure_object(read, ITEMS[self.item])

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and the tool, then the object, coarse and fine."""
        flags = ("left_touch", "right_touch", "over", "inside")
        return {
            **observe_arm_and_tool(m, CENTRE),
            "object_pos": 4.0 * (m["object_pos"] - CENTRE),
            "to_grip": coarse(m["to_grip"]),
            "to_grip_fine": fine(m["to_grip"]),
            "to_place": 4.0 * m["to_place"],
            "to_place_fine": 10.0 * np.clip(m["to_place"], -0.1, 0.1),
            **self._observe_turn(m),
            "upright": m["object_mat"][:, 6:],
            "object_linvel": m["object_linvel"],
            "object_angvel": 0.2 * m["object_angvel"],
            "flags": np.stack([m[name] for name in flags], axis=1).astype(float),
        }

    def _observe_turn(self, m: Measures) -> dict[str, Array]:
        """The object's yaw relative to the tool, unless all yaws are alike."""
        symmetry = ITEMS[self.item].symmetry
        if not symmetry:
            return {}
        turn = yaw_angle(m["object_mat"]) - yaw_angle(m["eef_mat"])
        return {"turn": cos_sin(symmetry * turn)}

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        return rewards.TERMS[reward](m, self.success(m))

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's and the object's (see `object_measures`), then of its place.

        place_distance [N] m from the object to its place, horizontal.
        """
        return {
            **super().visible_measures(m),
            **object_measures(m, "object"),
            "place_distance": np.linalg.norm(m["to_place"], axis=1),
        }

    def success(self, m: Measures) -> Array:
        """The object is in its quarter of the bin, and the tool away from it."""
        return m["inside"] & (m["distance"] > rewards.CLEAR)

    def expert(self, m: Measures) -> Array:
        """See `manip.tasks.experts.pick_place_expert`."""
        return pick_and_place(m, BIN, ITEMS[self.item].symmetry)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 3 cm of the grip; lift: by 10 cm; across: past the wall.

        grasp: a firm grasp; over: grasped over its place; place: success.
        """
        lifted = m["firm_grasp"] & (m["height"] > 0.1)
        return {
            "near": np.linalg.norm(m["to_grip"], axis=1) < 0.03,
            "grasp": m["firm_grasp"],
            "lift": lifted,
            "across": lifted & (m["object_pos"][:, 1] > WALL),
            "over": m["firm_grasp"] & m["over"],
            "place": self.success(m),
        }


class PickPlaceMilk(OneObject):
    """The milk carton."""

    robosuite_name = "PickPlaceMilk"
    item, body = "Milk", "Milk_main"
    sensors = _sensors("Milk")


class PickPlaceBread(OneObject):
    """The loaf of bread."""

    robosuite_name = "PickPlaceBread"
    item, body = "Bread", "Bread_main"
    sensors = _sensors("Bread")


class PickPlaceCereal(OneObject):
    """The cereal box, which fits between the fingers one way only."""

    robosuite_name = "PickPlaceCereal"
    item, body = "Cereal", "Cereal_main"
    sensors = _sensors("Cereal")


class PickPlaceCan(OneObject):
    """The can."""

    robosuite_name = "PickPlaceCan"
    item, body = "Can", "Can_main"
    sensors = _sensors("Can")
