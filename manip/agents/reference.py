"""Start from a trained policy, the reference, and stay close to it or learn from it."""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from math import log
from typing import Annotated, Any

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from manip.agents.agent import Agent, Spaces
from manip.agents.gaussian_actor import GaussianActorConfig, make_gaussian
from manip.agents.networks import Actor
from manip.agents.on_policy import RolloutPolicy
from manip.agents.policy import load_policy
from manip.errors import UserError
from manip.io.option_ranges import COUNT, NUMBER, POSITIVE


@dataclass(frozen=True)
class FineTuningConfig(GaussianActorConfig):
    """Options of algorithms that change a reference by supervised learning."""

    reference: str | None = None
    """Policy to start from: a run folder or a shipped name. It sets the options of the
    network."""
    reference_std: Annotated[float, POSITIVE] = 0.1
    """Standard deviation of the actions at the start, as a fraction of their range,
    where the reference gives none: a policy of SAC, TD3 or BC is deterministic. A
    larger value explores more, and fails more often."""
    rollout_length: Annotated[int, COUNT] = 32
    """Control steps of each environment in a rollout."""
    learning_rate: Annotated[float, NUMBER] = 3e-4
    """Adam's step size."""


class FineTuning(Agent):
    """Base of algorithms that change a reference by supervised learning.

    Attributes:
        gaussian: distribution of the actions: the actor, or around a bounded actor.
        reference: the same before it learned.
    """

    actor: Actor
    needs_preferences = True

    def __init__(
        self, config: FineTuningConfig, spaces: Spaces, threads: int = 1
    ) -> None:
        self.rollout_length = config.rollout_length
        self.actor, self.gaussian = make_gaussian(config, spaces)
        if config.reference is not None:
            start_from_reference(self, config.reference, config.reference_std)
        self.reference = deepcopy(self.gaussian)
        self._optim = torch.optim.Adam(
            self.gaussian.parameters(), config.learning_rate, fused=True
        )

    def policy(self) -> TensorDictModuleBase:
        """Return samples of the actor."""
        return RolloutPolicy(self.gaussian)

    def start_from(self, weights: Mapping[str, Tensor], deviation: float) -> None:
        """See `Agent.start_from`."""
        super().start_from(weights, deviation)
        self.gaussian.log_std.data.fill_(log(deviation))

    def start_again(self) -> None:
        """Undo all learning: the actor is the reference."""
        self.gaussian.load_state_dict(self.reference.state_dict())
        self._optim.state.clear()

    def modules(self) -> dict[str, nn.Module]:
        """Return the actor's distribution, and the reference's."""
        return {"actor": self.gaussian, "reference": self.reference}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Return one for the actor."""
        return {"actor": self._optim}


def start_from_reference(agent: Any, where: str, std: float) -> None:
    """Load a trained policy into the actor of an agent, which is new.

    Args:
        agent: has `actor` and `start_from`.
        where: run folder or shipped name of the policy.
        std: standard deviation of the actions, as a fraction of each dimension's
            range, if the policy has squash: then its own is of another distribution.

    Raises:
        UserError: the policy has other networks than the agent.
    """
    trained, own = load_policy(where).actor, agent.actor
    weights = trained.state_dict()
    shapes = {name: weight.shape for name, weight in own.state_dict().items()}
    fits = {name: weight.shape for name, weight in weights.items()} == shapes
    if not isinstance(trained, Actor) or trained.squash != own.squash or not fits:
        raise UserError(
            f"the policy in {where} has other networks than this run: set the options "
            "actor_hidden, normalise and squash of --agent as it was trained with them"
        )
    if trained.squash:
        agent.start_from(weights, std)
    else:
        own.load_state_dict(weights)
