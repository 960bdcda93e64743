"""Save and restore the agent, the environments and the random state of a run."""

from typing import Any

import torch

from manip.agents.agent import Agent
from manip.errors import UserError, one_line
from manip.training.checkpoint import FORMAT
from manip.training.collector import Collector


def state_of(agent: Agent, collector: Collector, buffer: bool) -> dict[str, Any]:
    """Agent, environments and random state, as plain values and tensors.

    Args:
        buffer: include the agent's replay buffer.
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
    """Restore what `state_of` returned.

    Raises:
        UserError: the state is of other networks or environments.
    """
    try:
        for name, module in agent.modules().items():
            module.load_state_dict(state["modules"][name])
        for name, optimiser in agent.optimisers().items():
            optimiser.load_state_dict(state["optimisers"][name])
        agent.load_extra_state(state["agent"])
        collector.load_state(state["collector"])
        torch.set_rng_state(state["torch_rng"])
    except Exception as error:  # an algorithm or task of one's own may raise anything
        raise unfit(error) from error


def unfit(error: Exception) -> UserError:
    """The error for a checkpoint that does not fit its run."""
    message = one_line(error) or type(error).__name__
    return UserError(f"the checkpoint is of another configuration: {message}")
