"""Distribution of the actions around a squashed actor, for on-policy algorithms."""

import torch
from torch import Tensor, nn

from manip.agents.networks import Actor


class BoundedGaussian(nn.Module):
    """Gaussian whose mean is the deterministic action of a squashed actor.

        mean = action_scale tanh(loc(s)),  deviation = action_scale exp(log_std)

    The actor's own state-dependent deviation is not used. Unlike in SAC the samples are
    not squashed: on-policy losses need the log-probability of stored actions, and the
    inverse of tanh is inexact near -1 and 1.

    Args:
        actor: an actor with `squash`.

    Attributes:
        log_std: [A], log standard deviation of each dimension.
        observation_dim: D.
    """

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self.actor, self.observation_dim = actor, actor.observation_dim
        self.log_std = nn.Parameter(torch.full_like(actor.action_scale, -0.5))

    @property
    def action_scale(self) -> Tensor:
        """[A], the actor's."""
        return self.actor.action_scale

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation [..., A] for observations [..., D]."""
        mean = self.actor.decide(observation)
        return mean, (self.action_scale * self.log_std.exp()).expand_as(mean)
