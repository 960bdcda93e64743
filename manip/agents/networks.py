"""Networks of actors and critics, shared by the algorithms."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from manip.errors import UserError, at_least

MIN_LOG_STD, MAX_LOG_STD = -5.0, 2.0
"""Range of a state-dependent log standard deviation (SAC, common practice)."""


def mlp(
    inputs: int,
    outputs: int,
    hidden: Sequence[int],
    activation: type[nn.Module] = nn.ReLU,
    layer_norm: bool = False,
) -> nn.Sequential:
    """Fully connected network; `layer_norm` normalises before each activation."""
    layers: list[nn.Module] = []
    for width in hidden:
        layers.append(nn.Linear(inputs, width))
        if layer_norm:
            layers.append(nn.LayerNorm(width))
        layers.append(activation())
        inputs = width
    return nn.Sequential(*layers, nn.Linear(inputs, outputs))


def widths_of(network: nn.Module) -> list[int]:
    """Widths of a network's input, hidden layers and output."""
    linears = [layer for layer in network.modules() if isinstance(layer, nn.Linear)]
    return [linears[0].in_features, *(layer.out_features for layer in linears)]


def orthogonal(network: nn.Module, gain: float, last_gain: float) -> None:
    """Orthogonal weights and zero biases: `gain` inside, `last_gain` at the end."""
    linears = [layer for layer in network.modules() if isinstance(layer, nn.Linear)]
    for layer in linears:
        last = layer is linears[-1]
        nn.init.orthogonal_(layer.weight, last_gain if last else gain)
        nn.init.zeros_(layer.bias)


class RunningNorm(nn.Module):
    """(x - mean) / std of all observations seen by `update`, clipped to +-10.

    Mean and variance are exact over everything seen (Chan et al. 1979, parallel
    variance) and are saved with the network that holds them.
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
        """Take in observations x [..., D]."""
        x = x.reshape(-1, x.shape[-1])
        total = self.count + len(x)
        delta = x.mean(0) - self.mean
        share = len(x) / total
        spread = x.var(0, correction=0) * share + self.var * (1 - share)
        self.var.copy_(spread + delta.square() * share * (1 - share))
        self.mean.add_(delta * share)
        self.count.copy_(total)

    def forward(self, x: Tensor) -> Tensor:
        """x [..., D] normalised."""
        return ((x - self.mean) / (self.var + 1e-4).sqrt()).clamp(-10.0, 10.0)


class Actor(nn.Module):
    """Gaussian actor: observation [..., D] -> (loc, scale), each [..., A].

    Args:
        squash: SAC's form: tanh of a Gaussian whose standard deviation depends on
            the state. Otherwise PPO's: one standard deviation an action, and the
            action is clipped by the environment.
        normalise: keep a RunningNorm of the observations in front.
        action_scale: [A] in (0, 1], the part of each action's range that is used;
            all of it unless given. Small turns, say, keep exploration upright.
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
        """Mean and standard deviation: of the action, or of what tanh squashes."""
        out = self.body(self.norm(observation))
        if not self.squash:
            std = self.action_scale * self.log_std.exp()
            return self.action_scale * out, std.expand_as(out)
        loc, raw = out.chunk(2, -1)
        span = MAX_LOG_STD - MIN_LOG_STD
        return loc, (MIN_LOG_STD + span * (raw.tanh() + 1) / 2).exp()

    def decide(self, observation: Tensor) -> Tensor:
        """The deterministic action [..., A] in [-1, 1]."""
        loc, _ = self(observation)
        return self.squashed(loc) if self.squash else loc.clamp(-1.0, 1.0)

    def squashed(self, raw: Tensor) -> Tensor:
        """The action [..., A] of a sample of SAC's Gaussian."""
        return self.action_scale * raw.tanh()


class BinnedActor(nn.Module):
    """Values of discretised actions: observation [..., D] -> [..., A * bins].

    The sum of the values of one bin a dimension is Q(s, a), the mean over dimensions i
    of q_i = V + A_i - mean A_i; see `manip.agents.dqn`. The best bins are the action.

    Args:
        bins: values that each dimension can take, from -1 to 1.
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
        """q_i / A of every bin of every dimension, dimension by dimension."""
        value, raw = self.body(observation).tensor_split([1], -1)
        advantage = raw.unflatten(-1, (self.action_dim, self.bins))
        centred = advantage - advantage.mean(-1, keepdim=True)
        return (value.unsqueeze(-1) + centred).flatten(-2) / self.action_dim

    def decide(self, observation: Tensor) -> Tensor:
        """The deterministic action [..., A] in [-1, 1]."""
        return self.action_scale * self.values_of(self.best(observation))

    def best(self, observation: Tensor) -> Tensor:
        """[..., A] int, the bin of the highest value in each dimension."""
        values = self(observation).unflatten(-1, (self.action_dim, self.bins))
        return values.argmax(-1)

    def values_of(self, chosen: Tensor) -> Tensor:
        """Bins [..., A] int -> numbers from -1 to 1."""
        return 2 * chosen / (self.bins - 1) - 1

    def one_hot(self, values: Tensor) -> Tensor:
        """What `values_of` gave -> [..., A * bins], 1 at the bins, 0 elsewhere."""
        chosen = ((values + 1) / 2 * (self.bins - 1)).round().long()
        return nn.functional.one_hot(chosen, self.bins).flatten(-2)


def _scale(given: Sequence[float], action_dim: int) -> Tensor:
    scale = torch.tensor(given) if given else torch.ones(action_dim)
    if scale.shape != (action_dim,):
        raise UserError(
            f"action_scale has {len(scale)} numbers, the action has {action_dim}"
        )
    return scale


def seeded() -> torch.Generator:
    """Random numbers of their own, that follow from torch's seed."""
    return torch.Generator().manual_seed(int(torch.randint(2**62, ())))
