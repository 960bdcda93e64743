"""Build stock robosuite environments with settings for training.

The only module that imports robosuite. The batch engine compiles its scenes from these
environments, and is tested against them.
"""

from typing import Any

import numpy as np

from manip.compiled import fallback_cache
from manip.errors import UserError, check_choice, one_line
from manip.robot_config import RobotConfig, check_robot_config
from manip.sim.gl import keep_mujoco_gl
from manip.sim.robosuite_log import quiet, quiet_robosuite

# On import robosuite warns of optional packages, sets MUJOCO_GL, fails where numba
# cannot store compiled functions, and asserts that it may use MUJOCO_EGL_DEVICE_ID.
try:
    with quiet(), keep_mujoco_gl(), fallback_cache("robosuite"):
        import robosuite
        from robosuite.controllers import load_part_controller_config
        from robosuite.controllers.composite.composite_controller_factory import (
            refactor_composite_controller_config,
        )
        from robosuite.environments.base import REGISTERED_ENVS
        from robosuite.environments.manipulation.two_arm_env import TwoArmEnv
        from robosuite.utils import binding_utils
except AssertionError as error:
    raise UserError(f"robosuite cannot be imported: {one_line(error)}") from error

__all__ = [
    "PANDA",
    "PHYSICS_DT",
    "draw_with",
    "environment_class",
    "environment_names",
    "make_stock",
    "quiet_robosuite",
    "reseed",
]

PHYSICS_DT = 0.002
"""robosuite's simulation timestep [s] (robosuite/macros.py)."""

PANDA = RobotConfig()


def make_stock(
    name: str,
    robot: RobotConfig = PANDA,
    seed: int | None = None,
    **options: Any,
) -> Any:
    """Build `robosuite.make(name, robots=robot)` without rendering or cameras.

    A reset does not compile the model again. `options` are passed to robosuite. A
    two-armed environment gets two arms of the kind.

    Raises:
        UserError: unknown robot, controller, environment or control frequency.
    """
    check_robot_config(robot)
    arms = 2 if issubclass(environment_class(name), TwoArmEnv) else 1
    with quiet():
        settings = _settings(robot, seed) | options
        return robosuite.make(name, robots=[robot.arm] * arms, **settings)


def draw_with(backend: str) -> None:
    """Make robosuite draw with an OpenGL backend; it reads MUJOCO_GL when imported."""
    binding_utils._MUJOCO_GL = backend


def _settings(robot: RobotConfig, seed: int | None) -> dict[str, Any]:
    return {
        "has_renderer": False,
        "has_offscreen_renderer": False,
        "use_camera_obs": False,
        "hard_reset": False,
        "reward_shaping": True,
        "controller_configs": _controller_config(robot),
        "control_freq": robot.control_freq,
        "seed": seed,
        "ignore_done": True,
    }


def environment_class(name: str) -> type[Any]:
    """robosuite's class of an environment.

    Raises:
        UserError: no environment of that name is registered.
    """
    check_choice("robosuite environment", name, robosuite.ALL_ENVIRONMENTS)
    registered: type[Any] = REGISTERED_ENVS[name]
    return registered


def environment_names() -> tuple[str, ...]:
    """Names of all robosuite environments that are registered at present."""
    return tuple(sorted(robosuite.ALL_ENVIRONMENTS))


def reseed(env: Any, seed: int | np.random.SeedSequence) -> None:
    """Restart the random stream of a stock environment, in place.

    robosuite takes no seed at a reset (`GymWrapper.reset(seed)` has no effect). Its
    samplers hold references to `env.rng`, so the state of that generator is replaced.
    """
    env.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state


def _controller_config(robot: RobotConfig) -> Any:
    if robot.controller == "OSC_POSE":
        return None
    part = load_part_controller_config(default_controller=robot.controller)
    return refactor_composite_controller_config(part, robot.arm, ["right"])
