"""Where a run learns: on the GPU of `--engine warp`, or on the CPU."""

from collections.abc import Iterator

import torch

from manip.agents.registry import load_algorithm
from manip.agents.trajectory import CPU
from manip.errors import UserError
from manip.sim.warp.library import check_library
from manip.training.config import TrainConfig

CUDA = torch.device("cuda", 0)


def learner_device(config: TrainConfig) -> torch.device:
    """The device of networks, replay buffer and updates.

    Raises:
        UserError: a package or a CUDA device is missing.
    """
    if not _steps_on_gpu(config):
        return CPU
    check_library("cuda")
    if _why_on_cpu(config):
        return CPU
    if not torch.cuda.is_available():
        raise UserError(
            "--device cuda also learns there, and this torch finds no CUDA device: "
            "install torch with CUDA (pytorch.org), or choose --device cpu"
        )
    return CUDA


def learns_on_gpu(config: TrainConfig) -> bool:
    """Whether networks, replay buffer and updates are on the GPU of the physics.

    They are for algorithms that take a device, where the actor sees the state and the
    reward is the environment's.
    """
    return _steps_on_gpu(config) and not _why_on_cpu(config)


def placement_notes(config: TrainConfig) -> Iterator[str]:
    """Say where a run with physics on a GPU learns."""
    if learns_on_gpu(config):
        yield "physics and learner on cuda; gradients: TorchRL's losses"
    elif _steps_on_gpu(config):
        yield f"physics on cuda, learner on the CPU: {_why_on_cpu(config)}"


def _steps_on_gpu(config: TrainConfig) -> bool:
    return config.engine == "warp" and config.device != "cpu"


def _why_on_cpu(config: TrainConfig) -> str:
    """Why a run cannot learn on a GPU; empty if it can."""
    if not load_algorithm(config.algo).takes_device:
        return f"{config.algo} takes no other device (ppo and sac do)"
    if config.observe == "cameras":
        return "images are drawn on the host"
    return "clips are compared on the host" if config.preferences else ""
