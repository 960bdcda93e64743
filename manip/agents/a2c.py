"""Advantage actor-critic (Mnih et al. 2016, arXiv 1602.01783), on TorchRL's A2CLoss.

    actor:     max E log pi(a | s) A + c_H entropy
    critic:    min c_V (V(s) - R)^2,  R = A + V
    advantage: n steps:     A_t = r_t + ... + gamma^n V(s_{t+n}) - V(s_t), or
               GAE(lambda): A_t = sum_k (gamma lambda)^k delta_{t+k},
               delta_t = r_t + gamma (1 - terminated) V(s_{t+1}) - V(s_t)

A small n or lambda trusts the critic (bias), a large one the rewards (variance). All
worlds step together and make one batch: the paper's synchronous form. A time limit ends
the sum but is bootstrapped through.
"""

from dataclasses import dataclass

from tensordict import TensorDictBase
from torchrl.objectives import A2CLoss
from torchrl.objectives.value import GAE

from manip.agents.agent import Spaces
from manip.agents.on_policy import OnPolicy, OnPolicyConfig, losses
from manip.agents.value_targets import n_step_advantages
from manip.errors import UserError


@dataclass(frozen=True)
class A2CConfig(OnPolicyConfig):
    """Options of A2C; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    rollout_length: int = 8
    """Control steps of every world between two updates."""
    n_step: int | None = None
    """n, rewards that a target sums up (fewer at a rollout's end); by GAE if None."""
    gae_lambda: float = 0.95
    """lambda, decay of the sum of GAE, which is used where n_step is None."""
    entropy_coefficient: float = 0.002
    """c_H, weight of the entropy bonus."""


class A2C(OnPolicy):
    """A2C on TorchRL; see the module's docstring."""

    def __init__(self, config: A2CConfig, spaces: Spaces, threads: int = 1) -> None:
        self.config = config
        _check_steps(config)
        super().__init__(config, spaces)
        self._gae = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=None)

    def _make_loss(self) -> A2CLoss:
        return A2CLoss(
            self.stochastic,
            self.critic,
            entropy_coeff=self.config.entropy_coefficient,
            critic_coeff=self.config.critic_coefficient,
            loss_critic_type="l2",
        )

    def differentiate(self, batch: TensorDictBase) -> dict[str, float]:
        """Leave the loss's gradient in `gradient`, of a rollout [N, T] with values."""
        found = losses(self._loss(self._estimate(batch).reshape(-1)))
        self._differentiate(sum(found.values()))
        return {name: part.item() for name, part in found.items()}

    def load(self, other: "A2C") -> None:
        """Become a copy of another agent of this kind."""
        self._params.data.copy_(other._params.data)
        self.actor.norm.load_state_dict(other.actor.norm.state_dict())

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        """One step on the whole rollout [N, T]."""
        told = self.differentiate(batch)
        self._step()
        return told

    def _estimate(self, batch: TensorDictBase) -> TensorDictBase:
        if self.config.n_step is None:
            return self._gae(batch)
        n, gamma = self.config.n_step, self.config.gamma
        return n_step_advantages(batch, n, gamma, self.critic)


def _check_steps(config: A2CConfig) -> None:
    if config.n_step is not None and config.n_step > config.rollout_length:
        raise UserError(
            f"n_step is {config.n_step}, but a rollout has {config.rollout_length} "
            "steps: set rollout_length to as many at least"
        )
