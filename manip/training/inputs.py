"""What a run's actor sees: the state, or camera images and proprioception."""

from dataclasses import fields

from manip.agents.actor_inputs import camera_inputs
from manip.agents.agent import Spaces
from manip.agents.registry import algorithm_names, load_algorithm
from manip.cameras import CameraConfig
from manip.envs.adapters.torchrl import TaskEnv
from manip.errors import UserError
from manip.training.config import TrainConfig

OF_IMAGES = ("cameras", "parts", "image_size", "image_quality", "frames", "looks")
"""Options that matter only with `--observe cameras`."""


def cameras_of(config: TrainConfig) -> CameraConfig | None:
    """Cameras of a run's environments; None if the actor sees the state.

    Raises:
        UserError: no camera is named, the algorithm takes no images, or options of
            images are given to an actor that sees the state.
    """
    if config.observe == "state":
        _check_no_images(config)
        return None
    if not config.cameras:
        raise UserError("--observe cameras needs one camera or more: set --cameras")
    if not load_algorithm(config.algo).sees_images:
        able = [name for name in algorithm_names() if load_algorithm(name).sees_images]
        raise UserError(
            f"{config.algo} does not learn from cameras: choose one of "
            f"{', '.join(able)}, or --observe state"
        )
    return CameraConfig(
        config.cameras, config.image_size, config.image_quality, config.frames
    )


def _check_no_images(config: TrainConfig) -> None:
    """Raise `UserError` if an option of images is set that would have no effect."""
    for option in fields(config):
        if option.name not in OF_IMAGES:
            continue
        if getattr(config, option.name) != option.default:
            name = option.name.replace("_", "-")
            raise UserError(
                f"--{name} has no effect on a policy that sees the state: add "
                f"--observe cameras, or leave out --{name}"
            )


def spaces_of(config: TrainConfig, env: TaskEnv) -> Spaces:
    """Sizes of the networks, and what the actor sees of the environment.

    Raises:
        UserError: the observation lacks a part that the actor is to see.
    """
    spec = env.batch.observation_spec
    actor = None if config.observe == "state" else camera_inputs(spec, config.parts)
    dim = env.observation_spec["observation"].shape[-1]
    return Spaces(dim, env.action_spec.shape[-1], actor)
