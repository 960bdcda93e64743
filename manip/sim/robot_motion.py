"""Read how the robots of a batch engine moved in the last control period."""

from typing import Any

import mujoco
import numpy as np

from manip.arrays import namespace
from manip.sim.not_copied import DeepCopied
from manip.sim.robot_model import reading_prefix
from manip.sim.row_engine import RowEngine
from manip.sim.scene import Scene
from manip.sim.state_row import PEAKS

Array = np.ndarray


def hand_tilt(eef_mat: Array) -> Array:
    """[N] rad between the tool's z axis and straight down, of rotations [N, 9]."""
    axis = eef_mat[:, [2, 5, 8]]
    xp = namespace(axis)
    return xp.arctan2(xp.linalg.norm(axis[:, :2], axis=1), -axis[:, 2])


class RobotMotion(DeepCopied):
    """Named numbers about the motion of N robots.

    Args:
        scene: what is simulated, with `Scene.with_peaks`.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._geoms = [_robot_geoms(scene.physics, each) for each in scene.stock.robots]

    def read(self, engine: RowEngine) -> dict[str, Array]:
        """The motion of the last control period.

        joint_vel, peak_speed [N, k] rad/s and peak_torque [N, k] N m of the joints of
        all arms; hand_tilt [N, 1] rad, the largest between a tool's axis and straight
        down; self_contact [N, 1], 1 if links of an arm touch one another or their hand.
        """
        read = engine.read()
        prefixes = [reading_prefix(number) for number in range(len(self._geoms))]
        tilts = [hand_tilt(read[f"{prefix}eef_mat"]) for prefix in prefixes]
        return {
            "joint_vel": np.hstack([read[f"{prefix}joint_vel"] for prefix in prefixes]),
            **{name: read[name] for name in PEAKS},
            "hand_tilt": np.max(tilts, axis=0)[:, None],
            "self_contact": self._contacts(read["qpos"])[:, None],
        }

    def _contacts(self, qpos: Array) -> Array:
        """[N]: 1 where a robot touches itself in a pose of qpos [N, nq]."""
        model = self._scene.physics
        data, touches = mujoco.MjData(model), np.zeros(len(qpos))
        for env_id, pose in enumerate(qpos):
            data.qpos[:] = pose
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            first, second = data.contact.geom.T
            touches[env_id] = any(
                (robot[first] & robot[second] & ~(hand[first] & hand[second])).any()
                for hand, robot in self._geoms
            )
        return touches


def _robot_geoms(model: mujoco.MjModel, robot: Any) -> tuple[Array, Array]:
    """[ngeom] bool: the geoms of a robot's hand, and of the whole robot."""
    hand = _geoms_of(model, robot.gripper["right"].naming_prefix)
    return hand, hand | _geoms_of(model, robot.robot_model.naming_prefix)


def _geoms_of(model: mujoco.MjModel, prefix: str) -> Array:
    """[ngeom] bool: whether a geom belongs to a body whose name has the prefix."""
    bodies = [model.body(body).name.startswith(prefix) for body in model.geom_bodyid]
    return np.array(bodies, bool)
