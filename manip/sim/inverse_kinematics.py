"""Joint angles of the arm that bring the tool to a pose: damped least squares.

The tool's position comes first, its rotation as far as the position allows, and then
the arm's redundant joints return to the pose q0 from which the search begins:

    dq = P e_p + R (e_r - J_r P e_p) + (N - R J_r N) k (q0 - q)
    P = J_p^#,   N = I - P J_p,   R = (J_r N)^#,   A^# = A^T (A A^T + l I)^-1
    l = (e_p^2 + e_r^2) / 2 + 1e-6

e_p [3] m and e_r [3] rad are the tool's remaining motion, J_p and J_r [3, n] its
Jacobians. The damping l falls with the error (Nakamura, Hanafusa and Yoshikawa,
"Task-priority based redundancy control of robot manipulators", Int. J. Robotics
Research, 1987; Sugihara, "Solvability-unconcerned inverse kinematics by the
Levenberg-Marquardt method", IEEE Trans. Robotics, 2011).
"""

import mujoco
import numpy as np

from manip.sim.not_copied import NotCopied
from manip.sim.scene import Scene

Array = np.ndarray

ITERATIONS = 60
"""Iterations, after which the pose that has been reached counts."""
DAMPING = 1e-6
"""Least l of the equation."""
RETURN = 0.1
"""k of the equation: fraction of the way back to q0 in an iteration."""
MOST_MOTION = 0.1
"""Largest motion [m, rad] of the tool in an iteration."""
MOST_TURN = 0.2
"""Largest motion [rad] of a joint in an iteration."""
CLOSE = 5e-4, 5e-3
"""Errors [m], [rad] of a pose below which the search ends."""
NEAR = 1e-3, 0.6
"""Errors [m], [rad] of a pose that counts as reached: at the border of its workspace an
arm reaches a position only with a tilted hand."""


class InverseKinematics(NotCopied):
    """Bring the tool of a scene's arm to poses.

    Args:
        scene: whose arm moves; the joints' limits are those of its model.

    Raises:
        UserError: the scene has two arms.
    """

    def __init__(self, scene: Scene) -> None:
        self._model = scene.physics
        self._arm = scene.layout.only_robot("inverse kinematics").arm
        self._low, self._high = _joint_limits(scene)
        self._data = mujoco.MjData(self._model)
        self._jacobian = np.zeros((6, self._model.nv))

    def solve(self, qpos: Array, position: Array, rotation: Array) -> Array:
        """Bring the tool of n environments to its pose, from the arm's pose in qpos.

        Args:
            qpos: [n, nq], whose entries of the arm are replaced by the solution, or by
                the nearest pose that the search has come to.
            position: [n, 3] m of the grip site, world frame.
            rotation: [n, 9], its rotation matrix row by row.

        Returns:
            [n] bool: the position is reached, and the rotation nearly, within the
            joints' limits.
        """
        targets = zip(qpos, position, rotation.reshape(-1, 3, 3), strict=True)
        return np.array([self._solve(*target) for target in targets], bool)

    def _solve(self, qpos: Array, position: Array, rotation: Array) -> bool:
        joints, rest = self._arm.qpos, qpos[self._arm.qpos].copy()
        for _ in range(ITERATIONS):
            error = self._error(qpos, position, rotation)
            if _within(error, CLOSE):
                return True
            step = self._step(error, RETURN * (rest - qpos[joints]))
            step *= min(1.0, MOST_TURN / max(np.abs(step).max(), 1e-9))
            qpos[joints] = np.clip(qpos[joints] + step, self._low, self._high)
        return _within(self._error(qpos, position, rotation), NEAR)

    def _error(self, qpos: Array, position: Array, rotation: Array) -> Array:
        """[6]: the tool's remaining motion [m], [rad] in a pose of the scene."""
        data, tool = self._data, self._arm.tool
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, data)
        turn = rotation @ data.site_xmat[tool].reshape(3, 3).T
        return np.concatenate([position - data.site_xpos[tool], rotation_vector(turn)])

    def _step(self, error: Array, back: Array) -> Array:
        """[n]: the motion dq of the joints, where the model's pose is set."""
        mujoco.mj_comPos(self._model, self._data)
        both = self._jacobian[:3], self._jacobian[3:]
        mujoco.mj_jacSite(self._model, self._data, *both, self._arm.tool)
        of_position, of_rotation = (jac[:, self._arm.dof] for jac in both)
        motion = error * min(1.0, MOST_MOTION / max(np.abs(error).max(), 1e-9))
        damping = DAMPING + motion @ motion / 2
        inverse = _damped_inverse(of_position, damping)
        free = np.eye(len(back)) - inverse @ of_position
        turning = of_rotation @ free
        step = inverse @ motion[:3]
        second = _damped_inverse(turning, damping)
        step += second @ (motion[3:] - of_rotation @ step)
        return step + free @ back - second @ (turning @ back)


def _joint_limits(scene: Scene) -> tuple[Array, Array]:
    """[n] rad each: lower and upper limits, infinite for joints without limits."""
    model, arm = scene.physics, scene.layout.robots[0].arm
    limited = model.jnt_limited[model.dof_jntid[arm.dof]]
    low, high = scene.layout.joint_range[0].T
    return np.where(limited, low, -np.inf), np.where(limited, high, np.inf)


def _damped_inverse(matrix: Array, damping: float) -> Array:
    """[n, 3]: A^# of a matrix A [3, n]; see the module's docstring."""
    damped = matrix @ matrix.T + damping * np.eye(len(matrix))
    return np.linalg.solve(damped, matrix).T


def _within(error: Array, most: tuple[float, float]) -> bool:
    apart, turned = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
    return bool(apart < most[0] and turned < most[1])


def rotation_vector(matrix: Array) -> Array:
    """[3] rad: axis times angle of a rotation matrix [3, 3]."""
    quat, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(matrix).ravel())
    mujoco.mju_quat2Vel(vector, quat, 1.0)
    return vector
