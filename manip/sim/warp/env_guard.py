"""EnvGuard: return non-finite environments to where the step began."""

from typing import Any

import warp as wp

from manip.sim.stepping import LIMIT

_LIMIT = wp.constant(LIMIT)


@wp.func
def within_limits(values: wp.array2d[float], env: int) -> bool:
    """Whether all |values| of an environment are below the limit; False for NaN."""
    for k in range(values.shape[1]):
        if not wp.abs(values[env, k]) < _LIMIT:
            return False
    return True


@wp.func
def put_back(saved: wp.array2d[float], values: wp.array2d[float], env: int):
    """Copy an environment's row."""
    for k in range(values.shape[1]):
        values[env, k] = saved[env, k]


@wp.kernel(enable_backward=False)
def _isolate(
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    warmstart: wp.array2d[float],
    command: wp.array2d[float],
    saved_qpos: wp.array2d[float],
    saved_qvel: wp.array2d[float],
    saved_warmstart: wp.array2d[float],
    saved_command: wp.array2d[float],
    broken: wp.array[int],
) -> None:
    env = wp.tid()
    if not (within_limits(qpos, env) and within_limits(qvel, env)):
        broken[env] = 1
    if broken[env] != 0:
        put_back(saved_qpos, qpos, env)
        put_back(saved_qvel, qvel, env)
        put_back(saved_warmstart, warmstart, env)
        put_back(saved_command, command, env)


class EnvGuard:
    """Save the state before a control period, and return broken environments to it.

    Args:
        state: qpos, qvel, warm start [N, nv] and gripper command on the device.
        broken: [N] int, 1 for broken environments.
    """

    def __init__(self, state: list[Any], broken: Any) -> None:
        self._state, self._broken = state, broken
        self._saved = [wp.zeros_like(values) for values in state]

    def save(self) -> None:
        """Save the present state."""
        for saved, values in zip(self._saved, self._state, strict=True):
            if values.size:
                wp.copy(saved, values)

    def isolate(self) -> None:
        """Return environments that are broken or beyond the limits to the saved state.

        Called after each substep: NaN must not reach the next collision detection,
        whose memory all environments share.
        """
        inputs = [*self._state, *self._saved, self._broken]
        wp.launch(_isolate, dim=len(self._broken), inputs=inputs)
