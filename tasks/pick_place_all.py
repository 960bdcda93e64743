"""Carry four objects to their quarters of the other bin. robosuite's `PickPlace`.

Success: each object is in its quarter and away from the tool, as in `pick_place`.
Failure: none; an episode ends by its time limit.
Start: the four objects in the first bin, where each starts alone in `pick_place`,
    clear of one another; the arm as there.
Order: the object between the finger pads, else cereal, milk, can, bread. The tall ones
    come first, because the palm would hit them beside a low one; of those whose places
    are in a row from the robot's view, the far ones come first.
Shaped reward, in [0, 1] per step: see `one_at_a_time` and `pick_place_rewards`.
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Weights
from manip.rewards.kernels import near
from manip.sim.scene import Scene
from manip.tasks import pick_place_rewards as rewards
from manip.tasks.arm import start_qpos
from manip.tasks.experts.pick_place_all_expert import pick_and_place_all
from manip.tasks.one_at_a_time import OneAtATime, of_all, sensors_of, staged_reward
from manip.tasks.pick_place import (
    CENTRE,
    OneObject,
    PickPlaceBread,
    PickPlaceCan,
    PickPlaceCereal,
    PickPlaceMilk,
    object_sensors,
)
from manip.tasks.pick_place_items import BIN, standing, start_spots
from manip.tasks.pick_place_measures import over_quarter
from manip.tasks.pick_place_waypoints import NAMES
from manip.tasks.rotations import cos_sin, yaw_angle

Array = np.ndarray


class PickPlace(OneAtATime):
    """Carry all objects to their places; see the module's docstring."""

    robosuite_name = "PickPlace"
    sensors = sensors_of(
        {name: object_sensors(name) for name in ("Cereal", "Milk", "Can", "Bread")}
    )
    parts: ClassVar[dict[str, OneObject]] = {
        "Cereal": PickPlaceCereal(),
        "Milk": PickPlaceMilk(),
        "Can": PickPlaceCan(),
        "Bread": PickPlaceBread(),
    }
    centre, object_pos = CENTRE, "object_pos"
    proprioception = OneObject.proprioception
    horizon = 650
    milestone_names = (
        *("near", "grasp", "lift", "across", "over"),
        *("one", "two", "three", "all"),
    )
    waypoint_names = (*NAMES, "one", "two", "three")
    weights: ClassVar[Weights] = {
        "shaped": rewards.WEIGHTS["shaped"],
        "stock": {"staged": 0.175, "done": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the poses of all objects; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        for name, spots in start_spots(streams).items():
            body = scene.free_qpos(self.parts[name].body)
            qpos[:, body] = standing(streams, name, spots)
        return Start(qpos)

    def observe(self, m: Measures) -> dict[str, Array]:
        """As for one object; its turn is 0 where all yaws are alike."""
        turn = yaw_angle(m["object_mat"]) - yaw_angle(m["eef_mat"])
        return {**super().observe(m), "turn": cos_sin(m["symmetry"] * turn)}

    def stock_terms(self, m: Measures) -> dict[str, Array]:
        """Terms of robosuite's shaped reward (`PickPlace.staged_rewards`)."""
        each, done = self.each(m), m["done"]
        to_place = of_all(each, "to_place")
        over = over_quarter(to_place)
        nearer = 0.2 * near(np.linalg.norm(to_place, axis=2), 0.1)
        below = BIN[2] + rewards.LIFTED - m["all_pos"][:, :, 2]
        staged = staged_reward(
            each, ~done, below, lambda lift: np.where(over, 0.5, lift) + nearer
        )
        return {"staged": staged / 0.7, "done": done.mean(axis=1)}

    def expert(self, m: Measures) -> Array:
        """See `manip.tasks.experts.pick_place_all_expert`."""
        return pick_and_place_all(m, BIN)
