"""Door: turn the handle and pull the door open. robosuite's `Door`, with its latch.

Success: the hinge is open by more than 0.3 rad (robosuite's test); it stops at 0.4.
Failure: none; an episode ends by its time limit.
Start: the door's position uniform within +-1 cm of its mean, its yaw within 0.25 rad;
    door closed, handle level; arm in its default pose with 0.02 rad noise per joint.
Shaped reward, in [0, 1] per step: 0.1 reach + 0.2 turn + 0.4 open + 0.3 stay.
    reach: 1 - tanh(5 d) of the distance d [m] from the tool to the handle.
    turn: rises linearly until the handle is turned by 1.2 rad, up or down, which frees
        the latch.
    open: rises linearly over the first 0.35 rad of the hinge.
    stay: 1 on success.
    Once the hinge is open by 0.1 rad and the latch has passed the frame, reach and turn
    are 1. Otherwise policies learned to return to the handle of the open door, and
    pushed it shut.
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task, Weights
from manip.rewards.kernels import near, ramp
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.arm import observe_arm, start_qpos
from manip.tasks.experts.door_expert import open_door
from manip.tasks.rotations import yaw_quaternion

Array = np.ndarray

PLACE = np.array([-0.12, -0.35, 1.1])
"""Mean position [m] of the door (robosuite/environments/manipulation/door.py)."""
SPREAD = 0.01
"""Half width [m] of the square in which the door stands (ibid.)."""
YAW_RANGE = (-np.pi / 2 - 0.25, -np.pi / 2)
"""Range [rad] of the door's yaw (ibid.)."""
CENTRE = np.array([-0.12, -0.15, 1.05])
"""Origin [m] of the observed tool position."""
OPEN = 0.3
"""Angle [rad] of the hinge for success (ibid.)."""
AJAR = 0.1
"""Angle [rad] of the hinge from which the latch has passed the frame."""
FREE = 1.2
"""Angle [rad] of the handle from which the latch clears the frame."""


class Door(Task):
    """Open the door; see the module's docstring for the numbers."""

    robosuite_name = "Door"
    sensors = Sensors(
        bodies={"door": "Door_door"},
        sites={"handle": "Door_handle"},
        joints={"hinge": "Door_hinge", "handle": "Door_latch_joint"},
        touches={
            "left_touch": ("left_fingerpad", "Door_latch"),
            "right_touch": ("right_fingerpad", "Door_latch"),
        },
        fields={
            "door_place": ("body_pos", "Door_main"),
            "door_turn": ("body_quat", "Door_main"),
        },
    )
    horizon = 100
    milestone_names = ("near", "turned", "ajar", "open")
    weights: ClassVar[Weights] = {
        "shaped": {"reach": 0.1, "turn": 0.2, "open": 0.4, "stay": 0.3},
        "stock": {"reach": 0.25, "turn": 0.25, "open": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the door's pose; see the module's docstring."""
        qpos = start_qpos(scene, streams)
        spread = np.array([SPREAD, SPREAD, 0.0])
        place = PLACE + streams.uniform(-spread, spread, 3)
        turn = yaw_quaternion(streams.uniform(*YAW_RANGE, 1)[:, 0])
        return Start(qpos, {"door_place": place, "door_turn": turn})

    def measure(self, read: Measures) -> Measures:
        """Add the handle's offset from the tool, the angles of the joints and the door.

        to_handle [N, 3] m, distance [N] m; hinge [N] and handle [N] rad, the latter
        positive downwards; yaw [N] rad of the closed door from
        its mean.
        """
        to_handle = read["handle_pos"] - read["eef_pos"]
        yaw = 2 * np.arctan2(read["door_turn"][:, 3], read["door_turn"][:, 0])
        return {
            **read,
            "to_handle": to_handle,
            "distance": np.linalg.norm(to_handle, axis=1),
            "hinge": read["hinge_qpos"][:, 0],
            "handle": read["handle_qpos"][:, 0],
            "yaw": yaw - np.mean(YAW_RANGE),
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm, then the door: position, yaw, joints, offset of the handle."""
        return {
            **observe_arm(m, CENTRE),
            "door_place": 50.0 * (m["door_place"] - PLACE)[:, :2],
            "door_yaw": 8.0 * m["yaw"][:, None],
            "hinge": np.hstack([5.0 * m["hinge_qpos"], m["hinge_qvel"]]),
            "handle": np.hstack([m["handle_qpos"], 0.3 * m["handle_qvel"]]),
            "to_handle": np.clip(10.0 * m["to_handle"], -5.0, 5.0),
            "touch": np.stack([m["left_touch"], m["right_touch"]], axis=1),
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward."""
        turned = np.abs(m["handle"])
        if reward == "stock":
            pending = ~self.success(m)
            return {
                "reach": pending * near(m["distance"], 0.1),
                "turn": pending * ramp(turned, 0.0, np.pi / 2),
                "open": self.success(m).astype(float),
            }
        return {
            "reach": np.maximum(near(m["distance"], 0.2), m["hinge"] > AJAR),
            "turn": np.maximum(ramp(turned, 0.0, FREE), m["hinge"] > AJAR),
            "open": ramp(m["hinge"], 0.0, 0.35),
            "stay": self.success(m).astype(float),
        }

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """The hand's, then the door's.

        object_distance [N] m from the tool to the handle; handle_angle and hinge_angle
        [N] rad, how far they are turned.
        """
        return {
            **super().visible_measures(m),
            "object_distance": m["distance"],
            "handle_angle": np.abs(m["handle"]),
            "hinge_angle": m["hinge"],
        }

    def success(self, m: Measures) -> Array:
        """The hinge is open by more than 0.3 rad."""
        return m["hinge"] > OPEN

    def expert(self, m: Measures) -> Array:
        """See `manip.tasks.experts.door_expert`."""
        return open_door(m)

    def milestones(self, m: Measures) -> dict[str, Array]:
        """near: tool within 10 cm of the handle; turned, ajar: see FREE, AJAR; open."""
        return {
            "near": m["distance"] < 0.1,
            "turned": np.abs(m["handle"]) > FREE,
            "ajar": m["hinge"] > AJAR,
            "open": self.success(m),
        }
