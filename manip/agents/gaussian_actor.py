"""The Gaussian actor of algorithms that need the likelihood of stored actions."""

from dataclasses import dataclass
from typing import Annotated

from manip.agents.agent import AgentConfig, Spaces
from manip.agents.bounded_gaussian import BoundedGaussian
from manip.agents.networks import Actor
from manip.io.option_ranges import COUNT, Range


@dataclass(frozen=True)
class GaussianActorConfig(AgentConfig):
    """Options of the actor's network."""

    actor_hidden: Annotated[tuple[int, ...], COUNT] = (128, 128)
    """Widths of the actor's hidden layers."""
    normalise: bool = True
    """Normalise observations by running statistics, saved with the policy."""
    action_scale: Annotated[tuple[float, ...], Range(1e-6, 1)] = ()
    """Fraction of each action dimension's range that is used; 1 unless given."""
    squash: bool = False
    """Bound the mean of the actions by tanh, behind ReLU layers: the form of actors
    that SAC, TD3 and BC train. Needed to start from one; without compiled gradients."""


def make_gaussian(
    config: GaussianActorConfig, spaces: Spaces
) -> tuple[Actor, Actor | BoundedGaussian]:
    """Build an actor, and the distribution of its actions: itself, if unbounded."""
    actor = Actor(
        spaces.observation_dim,
        spaces.action_dim,
        config.actor_hidden,
        squash=config.squash,
        normalise=config.normalise,
        action_scale=config.action_scale,
    )
    return actor, BoundedGaussian(actor) if config.squash else actor
