"""A run's whole state in one file, so that it goes on where it stopped."""

from pathlib import Path
from typing import Any

import torch

from manip.agents.agent import Agent
from manip.errors import UserError, one_line
from manip.training.rollout import Collector
from manip.trees import load_tree, save_tree

FORMAT = 3
"""Version of the checkpoint file; raised when it changes incompatibly."""


def save_checkpoint(
    path: Path, agent: Agent, collector: Collector, progress: dict[str, Any]
) -> None:
    """Write agent, worlds, random state and progress, whole or not at all."""
    save_tree(
        path,
        {
            "format": FORMAT,
            "progress": progress,
            "modules": {name: m.state_dict() for name, m in agent.modules().items()},
            "optimisers": {n: o.state_dict() for n, o in agent.optimisers().items()},
            "agent": agent.extra_state(),
            "collector": collector.save_state(),
            "torch_rng": torch.get_rng_state(),
        },
    )


def load_checkpoint(path: Path, agent: Agent, collector: Collector) -> dict[str, Any]:
    """Put a saved state back into agent and worlds; returns the progress.

    Raises:
        UserError: no checkpoint, a damaged one, or one of other networks or worlds.
    """
    tree = load_tree(path)
    found = tree.get("format") if isinstance(tree, dict) else None
    if found != FORMAT:
        raise UserError(f"{path} has format {found}, not {FORMAT}")
    try:
        for name, module in agent.modules().items():
            module.load_state_dict(tree["modules"][name])
        for name, optimiser in agent.optimisers().items():
            optimiser.load_state_dict(tree["optimisers"][name])
        agent.load_extra_state(tree["agent"])
        collector.load_state(tree["collector"])
        torch.set_rng_state(tree["torch_rng"])
        progress: dict[str, Any] = tree["progress"]
    except (KeyError, RuntimeError, TypeError, ValueError) as error:
        raise UserError(
            f"{path} belongs to another configuration: {one_line(error)}"
        ) from error
    return progress
