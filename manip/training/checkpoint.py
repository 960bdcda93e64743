"""A run's whole state in one file, so that it goes on where it stopped."""

import time
import warnings
from pathlib import Path
from typing import Any

import torch

from manip.agents.agent import Agent
from manip.errors import DamagedError, UserError, one_line
from manip.io.atomic_files import link_file
from manip.io.tensor_trees import load_tree, save_tree
from manip.training.collector import Collector

FORMAT = 6
"""Version of the checkpoint file; raised when it changes incompatibly."""

SAVING_SHARE = 0.05
"""Checkpoints on the way may take this part of a run's time."""


class Checkpoints:
    """The checkpoints of a run folder: the latest, the one before it, and the best.

    A checkpoint is written once, and then has several names: the best is the latest,
    too, when it is new, and the latest becomes the previous.
    """

    def __init__(self, run: Path) -> None:
        self.latest, self.previous, self.best = (
            run / "checkpoints" / f"{name}.safetensors"
            for name in ("latest", "previous", "best")
        )
        self._latest_is_whole = False

    def exist(self) -> bool:
        """Whether there is anything to resume from."""
        return any(path.is_file() for path in (self.latest, self.previous, self.best))

    def save(self, state: dict[str, Any], best: bool) -> None:
        """Write a state as the latest, and call it the best, too, if it is."""
        if self._latest_is_whole:
            link_file(self.latest, self.previous)
        if best:  # first, as a run that goes on from the latest finds no better
            save_tree(self.best, state)
            link_file(self.best, self.latest)
        else:
            save_tree(self.latest, state)
        self._latest_is_whole = True

    def load(self) -> dict[str, Any]:
        """The newest state that is whole; warns of newer ones that are not.

        Raises:
            UserError: there is none, or it was written by another version.
        """
        damaged = None
        for path in (self.latest, self.previous, self.best):
            if path.is_file():
                try:
                    return self._checked(path, load_tree(path))
                except DamagedError as error:
                    damaged = damaged or error
                    warnings.warn(f"{error}; trying the one before", stacklevel=2)
        raise damaged or UserError(f"nothing to resume: there is no {self.latest}")

    def _checked(self, path: Path, state: Any) -> dict[str, Any]:
        found = state.get("format") if isinstance(state, dict) else None
        if found != FORMAT:
            raise UserError(f"{path} has format {found}, this version reads {FORMAT}")
        self._latest_is_whole = path == self.latest
        checked: dict[str, Any] = state
        return checked


def state_of(agent: Agent, collector: Collector, buffer: bool) -> dict[str, Any]:
    """Everything that the coming steps depend on: agent, worlds, random state.

    Args:
        buffer: with what the agent has stored of old rollouts.
    """
    return {
        "format": FORMAT,
        "modules": {name: m.state_dict() for name, m in agent.modules().items()},
        "optimisers": {n: o.state_dict() for n, o in agent.optimisers().items()},
        "agent": agent.extra_state(buffer),
        "collector": collector.save_state(),
        "torch_rng": torch.get_rng_state(),
    }


def restore(state: dict[str, Any], agent: Agent, collector: Collector) -> None:
    """Put back what `state_of` gave.

    Raises:
        UserError: the state is of other networks or worlds.
    """
    try:
        for name, module in agent.modules().items():
            module.load_state_dict(state["modules"][name])
        for name, optimiser in agent.optimisers().items():
            optimiser.load_state_dict(state["optimisers"][name])
        agent.load_extra_state(state["agent"])
        collector.load_state(state["collector"])
        torch.set_rng_state(state["torch_rng"])
    except Exception as error:  # whatever a file of another kind may lead to
        raise UserError(
            f"the checkpoint is of another configuration: {one_line(error)}"
        ) from error


class Saving:
    """When to save next, and what it costs.

    Args:
        every: seconds between checkpoints; more where those take long.

    Attributes:
        buffer: bytes of the replay buffer in the last checkpoint.
    """

    buffer = 0

    def __init__(self, every: float) -> None:
        self._every = every
        self._ended = time.monotonic()
        self._took = 0.0

    def due(self) -> bool:
        """Whether it is time for the next checkpoint."""
        wait = max(self._every, self._took / SAVING_SHARE)
        return time.monotonic() - self._ended > wait

    def cost(self, path: Path) -> str:
        """Size and time of the last checkpoint, in words."""
        size, buffer = path.stat().st_size / 2**20, self.buffer / 2**20
        part = f" ({buffer:,.1f} of them the replay buffer: --no-save-buffer)"
        whole = f"checkpoint: {size:,.1f} MiB{part if buffer > size / 10 else ''}"
        return f"{whole}, written in {self._took:.1f} s"

    def __enter__(self) -> None:
        self._began = time.monotonic()

    def __exit__(self, *_: object) -> None:
        self._ended = time.monotonic()
        self._took = self._ended - self._began


def size_of(buffer: Any) -> int:
    """Bytes of a tensor, or of all in a dict; 0 for None."""
    tensors = buffer.values() if isinstance(buffer, dict) else [buffer]
    return sum(tensor.nbytes for tensor in tensors if tensor is not None)
