"""Networks of actors and critics, shared by the algorithms.

Shapes: observation [..., D], action [..., A]; the leading dimensions are arbitrary.
"""

import math
from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor, nn

from manip.errors import UserError, at_least, shown

MIN_LOG_STD, MAX_LOG_STD = -5.0, 2.0
"""Range of a state-dependent log standard deviation, as in CleanRL's SAC."""

NORM_EPSILON, NORM_CLIP = 1e-4, 10.0
"""Constants of `RunningNorm`."""

MOST_LAYERS = 64
"""Most hidden layers of a network."""
MOST_NEURONS = 10**6
"""Most neurons of a layer, and most entries of an observation or action."""


def mlp(
    inputs: int,
    outputs: int,
    hidden: Sequence[int],
    activation: type[nn.Module] = nn.ReLU,
    layer_norm: bool = False,
) -> nn.Sequential:
    """Build a fully connected network; `layer_norm` normalises before activations.

    Raises:
        UserError: more than MOST_LAYERS hidden layers, or a width out of range.
    """
    check_widths(inputs, outputs, hidden)
    layers: list[nn.Module] = []
    for width in hidden:
        layers.append(nn.Linear(inputs, width))
        if layer_norm:
            layers.append(nn.LayerNorm(width))
        layers.append(activation())
        inputs = width
    return nn.Sequential(*layers, nn.Linear(inputs, outputs))


def check_widths(inputs: int, outputs: int, hidden: Sequence[int]) -> None:
    """Raise `UserError` for a network that is too large, or has no neurons."""
    if len(hidden) > MOST_LAYERS:
        raise UserError(
            f"{len(hidden)} hidden layers are too many: at most {MOST_LAYERS}"
        )
    for width in (inputs, *hidden, outputs):
        if not 1 <= width <= MOST_NEURONS:
            raise UserError(
                f"a layer of {shown(width)} neurons is not possible: choose from 1 to "
                f"{MOST_NEURONS}"
            )


def widths_of(network: nn.Module) -> list[int]:
    """Return the widths of a network's input, hidden layers and output."""
    linears = [layer for layer in network.modules() if isinstance(layer, nn.Linear)]
    return [linears[0].in_features, *(layer.out_features for layer in linears)]


def orthogonal(network: nn.Module, gain: float, last_gain: float) -> None:
    """Set orthogonal weights and zero biases (Saxe et al. 2013, arXiv 1312.6120).

    `last_gain` scales the last layer's weights, `gain` those of the others.
    """
    linears = [layer for layer in network.modules() if isinstance(layer, nn.Linear)]
    for layer in linears:
        last = layer is linears[-1]
        nn.init.orthogonal_(layer.weight, last_gain if last else gain)
        nn.init.zeros_(layer.bias)


class RunningNorm(nn.Module):
    """Normalise by the mean and variance of all observations passed to `update`.

        y = clip((x - mean) / sqrt(var + 1e-4), -10, 10)

    Mean and variance are exact (parallel variance, Chan et al. 1979) and are saved with
    the network.
    """

    mean: Tensor
    var: Tensor
    count: Tensor

    def __init__(self, width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("var", torch.ones(width))
        self.register_buffer("count", torch.tensor(0.0))

    @torch.no_grad()
    def update(self, x: Tensor) -> None:
        """Add observations x [..., D] to the statistics.

        With share = n / (n + count) and delta = mean(x) - mean:
        mean += share delta,
        var = share var(x) + (1 - share) var + share (1 - share) delta^2.
        """
        x = x.reshape(-1, x.shape[-1])
        total = self.count + len(x)
        delta = x.mean(0) - self.mean
        share = len(x) / total
        spread = x.var(0, correction=0) * share + self.var * (1 - share)
        self.var.copy_(spread + delta.square() * share * (1 - share))
        self.mean.add_(delta * share)
        self.count.copy_(total)

    def forward(self, x: Tensor) -> Tensor:
        """Normalise x [..., D]."""
        normal = (x - self.mean) / (self.var + NORM_EPSILON).sqrt()
        return normal.clamp(-NORM_CLIP, NORM_CLIP)


class Actor(nn.Module):
    """Gaussian actor: observation [..., D] -> (loc, scale), each [..., A].

    Args:
        squash: True for SAC's form, tanh of a Gaussian whose standard deviation
            depends on the state. False for PPO's: a standard deviation for each
            dimension of the action, which the environment clips.
        normalise: put a RunningNorm of the observations before the network.
        action_scale: [A] in (0, 1], fraction of each dimension's range that is used;
            1 by default. Small rotations keep the gripper upright while exploring.

    Raises:
        UserError: action_scale has another length than the action.
    """

    action_scale: Tensor
    bins = 0

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        hidden: Sequence[int],
        squash: bool,
        normalise: bool,
        action_scale: Sequence[float] = (),
    ) -> None:
        super().__init__()
        self.squash = squash
        self.observation_dim = observation_dim
        self.register_buffer("action_scale", _scale(action_scale, action_dim))
        self.norm = RunningNorm(observation_dim) if normalise else nn.Identity()
        activation = nn.ReLU if squash else nn.Tanh
        outputs = action_dim * (2 if squash else 1)
        self.body = mlp(observation_dim, outputs, hidden, activation)
        if not squash:
            orthogonal(self.body, 2**0.5, 0.01)
            self.log_std = nn.Parameter(torch.full((action_dim,), -0.5))

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation [..., A] (before tanh if `squash`)."""
        out = self.body(self.norm(observation))
        if not self.squash:
            std = self.action_scale * self.log_std.exp()
            return self.action_scale * out, std.expand_as(out)
        loc, raw = out.chunk(2, -1)
        span = MAX_LOG_STD - MIN_LOG_STD
        return loc, (MIN_LOG_STD + span * (raw.tanh() + 1) / 2).exp()

    def decide(self, observation: Tensor) -> Tensor:
        """Return the deterministic action [..., A] in [-1, 1]."""
        loc, _ = self(observation)
        return self.squashed(loc) if self.squash else loc.clamp(-1.0, 1.0)

    @torch.no_grad()
    def set_deviation(self, deviation: float) -> None:
        """Set the standard deviation, for every state.

        Args:
            deviation: before tanh if `squash`, as a fraction of the range that is used.
        """
        log_std = math.log(deviation)
        if not self.squash:
            self.log_std.fill_(log_std)
            return
        span = MAX_LOG_STD - MIN_LOG_STD
        last = cast(nn.Linear, self.body[-1])
        first = len(self.action_scale)
        last.weight[first:] = 0.0
        last.bias[first:] = math.atanh(2 * (log_std - MIN_LOG_STD) / span - 1)

    def squashed(self, raw: Tensor) -> Tensor:
        """Map a Gaussian sample [..., A] to an action: action_scale tanh(raw)."""
        return self.action_scale * raw.tanh()


class BinnedActor(nn.Module):
    """Values of discretised actions: observation [..., D] -> [..., A * bins].

    Each dimension i of the action takes one of `bins` values from -1 to 1. With
    q_i = V + A_i - mean A_i, the network returns q_i / A for each bin of each
    dimension, so that Q(s, a), the mean of q_i(s, a_i), is the sum of A outputs; see
    `manip.agents.dqn`. The deterministic action is the best bin of each dimension.

    Args:
        bins: number of values that each dimension of the action can take.
        action_scale: as for `Actor`.
    """

    action_scale: Tensor
    squash = False

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        hidden: Sequence[int],
        bins: int,
        action_scale: Sequence[float] = (),
    ) -> None:
        super().__init__()
        self.observation_dim, self.action_dim = observation_dim, action_dim
        self.bins = bins
        at_least(2, "bins", bins)
        self.register_buffer("action_scale", _scale(action_scale, action_dim))
        self.norm = nn.Identity()
        self.body = mlp(observation_dim, 1 + action_dim * bins, hidden, layer_norm=True)

    def forward(self, observation: Tensor) -> Tensor:
        """Return q_i / A, [..., A * bins], dimension by dimension."""
        value, raw = self.body(observation).tensor_split([1], -1)
        advantage = raw.unflatten(-1, (self.action_dim, self.bins))
        centred = advantage - advantage.mean(-1, keepdim=True)
        return (value.unsqueeze(-1) + centred).flatten(-2) / self.action_dim

    def decide(self, observation: Tensor) -> Tensor:
        """Return the deterministic action [..., A] in [-1, 1]."""
        return self.action_scale * self.values_of(self.best(observation))

    def best(self, observation: Tensor) -> Tensor:
        """Return the bin of the highest value in each dimension, int [..., A]."""
        values = self(observation).unflatten(-1, (self.action_dim, self.bins))
        return values.argmax(-1)

    def values_of(self, indices: Tensor) -> Tensor:
        """Map bins, int [..., A], to numbers from -1 to 1."""
        return 2 * indices / (self.bins - 1) - 1

    def one_hot(self, values: Tensor) -> Tensor:
        """Map numbers [..., A] from `values_of` to one-hot vectors [..., A * bins]."""
        indices = ((values + 1) / 2 * (self.bins - 1)).round().long()
        return nn.functional.one_hot(indices, self.bins).flatten(-2)


def _scale(given: Sequence[float], action_dim: int) -> Tensor:
    scale = torch.tensor(given) if given else torch.ones(action_dim)
    if scale.shape != (action_dim,):
        raise UserError(
            f"action_scale has {len(scale)} numbers, the action has {action_dim}: "
            "give a number for each dimension of the action, or none"
        )
    return scale


def seeded_generator(device: torch.device | str = "cpu") -> torch.Generator:
    """Return a new random generator, seeded from torch's global one of the CPU."""
    return torch.Generator(device).manual_seed(int(torch.randint(2**62, ())))
