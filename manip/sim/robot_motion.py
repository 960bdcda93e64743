"""Read how the robots of a batch engine moved in the last control period."""

import mujoco
import numpy as np

from manip.arrays import namespace
from manip.sim.not_copied import DeepCopied
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
        robot = scene.stock.robots[0]
        hand = robot.gripper["right"].naming_prefix
        self._hand = _geoms_of(scene.physics, hand)
        self._robot = self._hand | _geoms_of(
            scene.physics, robot.robot_model.naming_prefix
        )

    def read(self, engine: RowEngine) -> dict[str, Array]:
        """The motion of the last control period.

        joint_vel, peak_speed [N, n] rad/s; peak_torque [N, n] N m; hand_tilt [N, 1]
        rad between the tool's axis and straight down; self_contact [N, 1], 1 if links
        of the arm touch one another or the hand.
        """
        read = engine.read()
        return {
            "joint_vel": read["joint_vel"],
            **{name: read[name] for name in PEAKS},
            "hand_tilt": hand_tilt(read["eef_mat"])[:, None],
            "self_contact": self._contacts(read["qpos"])[:, None],
        }

    def _contacts(self, qpos: Array) -> Array:
        """[N]: 1 where the robot touches itself in a pose of qpos [N, nq]."""
        model = self._scene.physics
        data, touches = mujoco.MjData(model), np.zeros(len(qpos))
        for env_id, pose in enumerate(qpos):
            data.qpos[:] = pose
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            first, second = data.contact.geom.T
            inside = self._robot[first] & self._robot[second]
            touches[env_id] = (inside & ~(self._hand[first] & self._hand[second])).any()
        return touches


def _geoms_of(model: mujoco.MjModel, prefix: str) -> Array:
    """[ngeom] bool: whether a geom belongs to a body whose name has the prefix."""
    bodies = [model.body(body).name.startswith(prefix) for body in model.geom_bodyid]
    return np.array(bodies, bool)
