"""The network of a learned reward: an ensemble of small MLPs, evaluated side by side.

Each member k maps the inputs x of a control step to a reward in [0, 1]:

    z = (x - mean) / std
    r_k(x) = (1 + tanh(MLP_k(z))) / 2

The ensemble's reward is the members' mean (Lee et al. 2021, arXiv 2106.05091, which
bounds by tanh as well). Bounded rewards cannot be raised without limit by inputs that
no comparison was about.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from manip.agents.networks import check_widths

LEAST_STD = 0.05
"""Least standard deviation by which an input [m, rad, m/s, ...] is divided. The height
of an object that was never lifted varies by millimetres: divided by these, a lift would
be far from all that was compared, and its reward arbitrary."""

STANDARD = 0.1
"""Standard deviation of standardised rewards: returns with gamma = 0.97 are then of
order one, which a new critic learns in its first rollouts."""


class RewardNetwork(nn.Module):
    """Members of equal shape; their parameters are stacked along the first dimension.

    Args:
        inputs: F, numbers that describe a step.
        members: K, number of MLPs.
        hidden: widths of the hidden layers (ReLU).
        generator: draws the initial weights, uniform in +-1/sqrt(fan in).

    Attributes:
        mean, std: [F], statistics of the inputs by which they are normalised.
        offset, scale: of the reward that is paid, (mean_k r_k - offset) / scale.
    """

    mean: Tensor
    std: Tensor
    offset: Tensor
    scale: Tensor

    def __init__(
        self,
        inputs: int,
        members: int,
        hidden: Sequence[int],
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        check_widths(inputs, 1, hidden)
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("std", torch.ones(inputs))
        self.register_buffer("offset", torch.tensor(0.0))
        self.register_buffer("scale", torch.tensor(1.0))
        widths = [inputs, *hidden, 1]
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for before, after in pairwise(widths):
            for part, rows in ((self.weights, before), (self.biases, 1)):
                unit = torch.rand(members, rows, after, generator=generator)
                part.append(nn.Parameter((2 * unit - 1) * before**-0.5))

    def forward(self, inputs: Tensor) -> Tensor:
        """Map inputs [B, F], or [K, B, F] for each member, to rewards [K, B]."""
        hidden = ((inputs - self.mean) / self.std).expand(len(self.weights[0]), -1, -1)
        last = len(self.weights) - 1
        for index, (weight, bias) in enumerate(
            zip(self.weights, self.biases, strict=True)
        ):
            hidden = torch.baddbmm(bias, hidden, weight)
            hidden = hidden if index == last else hidden.relu()
        return (1 + hidden.squeeze(-1).tanh()) / 2

    def rewards(self, inputs: Tensor) -> Tensor:
        """Map inputs [..., F] to the members' rewards [K, ...]."""
        flat: Tensor = self(inputs.flatten(0, -2))
        return flat.unflatten(1, inputs.shape[:-1])

    def paid(self, inputs: Tensor) -> Tensor:
        """Map inputs [..., F] to the rewards [...] that are paid."""
        return (self.rewards(inputs).mean(0) - self.offset) / self.scale

    @torch.no_grad()
    def standardise(self, inputs: Tensor) -> None:
        """Pay rewards of mean 0 and deviation STANDARD over inputs [..., F]."""
        rewards = self.rewards(inputs).mean(0)
        self.offset.copy_(rewards.mean())
        self.scale.copy_(rewards.std(correction=0).clamp_min(1e-3) / STANDARD)

    @torch.no_grad()
    def normalise_by(self, inputs: Tensor) -> None:
        """Set the statistics to those of inputs [..., F], with at least LEAST_STD."""
        flat = inputs.flatten(0, -2)
        self.mean.copy_(flat.mean(0))
        self.std.copy_(flat.std(0, correction=0).clamp_min(LEAST_STD))
