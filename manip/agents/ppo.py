"""Proximal policy optimisation (Schulman et al. 2017, arXiv 1707.06347), on TorchRL.

    ratio:     rho = pi(a | s) / pi_old(a | s)
    actor:     max E min(rho A, clip(rho, 1 - eps, 1 + eps) A) + c_H entropy
    critic:    min c_V (V(s) - R)^2
    advantage: GAE(lambda): A_t = sum_k (gamma lambda)^k delta_{t+k},
               delta_t = r_t + gamma (1 - terminated) V(s_{t+1}) - V(s_t)

R = A + V. A time limit ends the sum but is bootstrapped through.
"""

from copy import deepcopy
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from manip.agents.agent import Agent, Spaces
from manip.agents.networks import Actor, RunningNorm, mlp, orthogonal, seeded
from manip.agents.ppo_gradients import Told, flatten_networks, gradients_of, rows_of


@dataclass(frozen=True)
class PPOConfig:
    """Options of PPO; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    gamma: float = 0.97
    """Discount a control step."""
    gae_lambda: float = 0.95
    """Decay of the advantage estimate's sum."""
    clip: float = 0.2
    """Range of the probability ratio that is rewarded."""
    learning_rate: float = 5e-4
    """Adam's step size."""
    rollout_length: int = 32
    """Control steps of every world between two updates."""
    epochs: int = 5
    """Passes over each rollout."""
    minibatches: int = 8
    """Pieces that each pass is split into."""
    entropy_coefficient: float = 0.002
    """c_H, weight of the entropy bonus."""
    critic_coefficient: float = 0.5
    """c_V, weight of the critic's loss."""
    max_gradient: float = 1.0
    """Gradients are scaled down to this norm."""
    target_kl: float = 0.05
    """A pass is the last one when it moved the policy this far: mean KL divergence."""
    actor_hidden: tuple[int, ...] = (128, 128)
    """Widths of the actor's hidden layers."""
    critic_hidden: tuple[int, ...] = (128, 128)
    """Widths of the critic's hidden layers."""
    normalise: bool = True
    """Normalise observations by running statistics, saved with the policy."""
    action_scale: tuple[float, ...] = ()
    """Part of each OSC_POSE action's range used at first; all of it unless given."""


class RolloutPolicy(TensorDictModuleBase):
    """Samples a copy of the actor; writes the action and its log-probability."""

    in_keys = ["observation"]
    out_keys = ["action", "action_log_prob"]

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self._actor, self._generator = deepcopy(actor), seeded()

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A] and `action_log_prob` [N]."""
        loc, scale = self._actor(tensordict["observation"])
        noise = torch.randn(loc.shape, generator=self._generator)
        action = loc + scale * noise
        log_prob = IndependentNormal(loc, scale).log_prob(action)
        return tensordict.set("action_log_prob", log_prob).set("action", action)


class PPO(Agent):
    """PPO on TorchRL; see the module's docstring."""

    def __init__(self, config: PPOConfig, spaces: Spaces, threads: int = 1) -> None:
        self.config = config
        self.rollout_length = config.rollout_length
        self.actor = Actor(
            spaces.observation_dim,
            spaces.action_dim,
            config.actor_hidden,
            squash=False,
            normalise=config.normalise,
            action_scale=config.action_scale,
        )
        self._critic = _critic(config, spaces, self.actor.norm)
        self._loss = _loss(config, self.actor, self._critic)
        self._gae = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=None)
        self._params = flatten_networks(self.actor, self._critic)
        self._gradients = gradients_of(
            self._loss, self.actor, self._critic, self._params, threads
        )
        self._optim = torch.optim.Adam(
            [self._params], config.learning_rate, eps=1e-5, fused=True
        )

    def policy(self) -> TensorDictModuleBase:
        """Samples of the actor, with log-probabilities."""
        return RolloutPolicy(self.actor)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Several epochs on the rollout [N, T]."""
        self._gae(add_values(batch, self._critic))
        rows = rows_of(batch.reshape(-1))
        size = -(-len(rows) // self.config.minibatches)
        for _ in range(self.config.epochs):
            shuffled = rows[torch.randperm(len(rows))]
            told = [self._learn(minibatch) for minibatch in shuffled.split(size)]
            if sum(found.kl for found in told) / len(told) > self.config.target_kl:
                break
        if isinstance(self.actor.norm, RunningNorm):
            self.actor.norm.update(batch["observation"])
        return told[-1]._asdict()

    def modules(self) -> dict[str, nn.Module]:
        """The loss holds actor and critic."""
        return {"loss": self._loss}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """One for everything."""
        return {"all": self._optim}

    def _learn(self, rows: Tensor) -> Told:
        told = self._gradients(rows)
        nn.utils.clip_grad_norm_([self._params], self.config.max_gradient)
        self._optim.step()
        return told


@torch.no_grad()
def add_values(batch: TensorDictBase, critic: nn.Module) -> TensorDictBase:
    """Write state_value, now and next, of a rollout [N, T].

    The value of a successor is that of the next step's state, except where an episode
    or the rollout ends: there the true successor is valued.
    """
    value = critic(batch.select("observation"))["state_value"]
    following = torch.empty_like(value)
    following[:, :-1] = value[:, 1:]
    ends = batch["next", "done"].squeeze(-1).clone()
    ends[:, -1] = True
    last = batch["next"].select("observation")[ends]
    following[ends] = critic(last)["state_value"]
    batch.set("state_value", value)
    return batch.set(("next", "state_value"), following)


def _critic(config: PPOConfig, spaces: Spaces, norm: nn.Module) -> ValueOperator:
    body = mlp(spaces.observation_dim, 1, config.critic_hidden, nn.Tanh)
    orthogonal(body, 2**0.5, 1.0)
    return ValueOperator(nn.Sequential(norm, body), in_keys=["observation"])


def _loss(config: PPOConfig, actor: Actor, critic: ValueOperator) -> ClipPPOLoss:
    stochastic = ProbabilisticActor(
        TensorDictModule(actor, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    return ClipPPOLoss(
        stochastic,
        critic,
        clip_epsilon=config.clip,
        entropy_coeff=config.entropy_coefficient,
        critic_coeff=config.critic_coefficient,
        loss_critic_type="l2",
        normalize_advantage=True,
    )
