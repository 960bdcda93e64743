"""Deep Q-learning (Mnih et al. 2015, doi 10.1038/nature14236), with TorchRL's DQNLoss.

    critic: min (Q(s, a) - y)^2,
            y = r + gamma r' + ... + gamma^n (1 - terminated) Q'(s', a'),
            a' = argmax Q(s', .)    (double: van Hasselt et al. 2015, arXiv 1509.06461)
    policy: argmax Q(s, .); while exploring, each dimension is drawn at random with
            probability epsilon

Each dimension of the action takes one of `bins` values, and Q(s, a) is the mean over
the dimensions i of q_i(s, a_i) (Seyde et al. 2022, arXiv 2210.12566): the maximum over
all bins^7 actions follows dimension by dimension. q_i = V + A_i - mean A_i (dueling:
Wang et al. 2015, arXiv 1511.06581). s' is the state n steps later, Q' the exponential
average of Q. A time limit is no termination: y bootstraps from the true last
observation. For n > 1 the rewards between s and s' are older policies' (off-policy
bias, not corrected).
"""

from dataclasses import dataclass
from functools import partial
from typing import Annotated

import torch
from tensordict.nn import (
    TensorDictModule,
    TensorDictModuleBase,
    TensorDictSequential,
)
from torch import Generator, Tensor, nn
from torch.optim import Adam
from torchrl.modules import QValueModule
from torchrl.objectives import DQNLoss, SoftUpdate

from manip.agents.agent import Spaces
from manip.agents.exploration import RolloutPolicy
from manip.agents.networks import BinnedActor
from manip.agents.off_policy import (
    OffPolicy,
    OffPolicyConfig,
    descend,
    transitions_of,
)
from manip.io.option_ranges import SHARE, Range


@dataclass(frozen=True)
class DQNConfig(OffPolicyConfig):
    """Options of DQN; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    bins: Annotated[int, Range(2, 1000)] = 3
    """Number of values that each dimension of an action can take, from -1 to 1."""
    double: bool = True
    """Choose a' by Q (double DQN), not by Q', which overestimates."""
    epsilon: Annotated[float, SHARE] = 0.1
    """Probability that a dimension is drawn at random, after random_steps."""


class DQN(OffPolicy):
    """DQN; see the module's docstring."""

    name = "dqn"
    Config = DQNConfig
    actor: BinnedActor

    def __init__(self, config: DQNConfig, spaces: Spaces, threads: int = 1) -> None:
        super().__init__(config, spaces)
        self.config = config
        self.actor = BinnedActor(
            spaces.observation_dim,
            spaces.action_dim,
            config.critic_hidden,
            config.bins,
            config.action_scale,
        )
        self._loss = _loss(config, self.actor)
        self._targets = SoftUpdate(self._loss, tau=config.tau)
        self._optim = Adam(self.actor.parameters(), config.learning_rate, fused=True)

    def policy(self) -> TensorDictModuleBase:
        """Return random bins at first, later an epsilon-greedy policy."""
        epsilon = 1.0 if self.warming_up else self.config.epsilon
        explore, bursts = partial(_greedy, epsilon=epsilon), self.config.gripper_bursts
        inputs = self._spaces.inputs
        return RolloutPolicy(self.actor, inputs, explore, bursts=bursts)

    def modules(self) -> dict[str, nn.Module]:
        """Return the loss, which holds the critic and its target."""
        return {"loss": self._loss}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Return one for everything."""
        return {"all": self._optim}

    def _learn(self, rows: Tensor) -> dict[str, float]:
        batch = transitions_of(rows, self.actor.observation_dim)
        unit = batch["action"] / self.actor.action_scale
        batch["action"] = self.actor.one_hot(unit)
        loss = self._loss(batch)["loss"]
        descend(self._optim, loss)
        self._targets.step()
        return {"loss_critic": loss.item()}


def _greedy(
    actor: BinnedActor, inputs: tuple[Tensor, ...], draw: Generator, epsilon: float
) -> Tensor:
    best = actor.best(*inputs)
    uniform = torch.randint(actor.bins, best.shape, generator=draw)
    explores = torch.rand(best.shape, generator=draw) < epsilon
    return actor.values_of(torch.where(explores, uniform, best))


def _loss(config: DQNConfig, actor: BinnedActor) -> DQNLoss:
    network = TensorDictSequential(
        TensorDictModule(actor, ["observation"], ["action_value"]),
        QValueModule(
            action_space="mult_one_hot", var_nums=[config.bins] * actor.action_dim
        ),
    )
    loss = DQNLoss(network, action_space="mult_one_hot", double_dqn=config.double)
    loss.make_value_estimator(gamma=config.gamma)
    return loss
