"""Advantage actor-critic (Mnih et al. 2016, arXiv 1602.01783), with TorchRL's A2CLoss.

    actor:     max E log pi(a | s) A + c_H entropy
    critic:    min c_V (V(s) - R)^2,  R = A + V
    advantage: n steps:     A_t = r_t + ... + gamma^n V(s_{t+n}) - V(s_t), or
               GAE(lambda): A_t = sum_k (gamma lambda)^k delta_{t+k},
               delta_t = r_t + gamma (1 - terminated) V(s_{t+1}) - V(s_t)

A small n or lambda relies on the critic (bias), a large one on the rewards (variance).
All environments step together and make one batch: the synchronous form of the paper. A
time limit ends the sum, which then bootstraps from the true last observation.
"""

from dataclasses import dataclass
from typing import Annotated

from tensordict import TensorDictBase
from torchrl.objectives import A2CLoss
from torchrl.objectives.value import GAE

from manip.agents.agent import Spaces
from manip.agents.on_policy import OnPolicy, OnPolicyConfig, losses
from manip.agents.value_targets import n_step_advantages
from manip.errors import UserError
from manip.io.option_ranges import COUNT, NUMBER, SHARE


@dataclass(frozen=True)
class A2CConfig(OnPolicyConfig):
    """Options of A2C; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    rollout_length: Annotated[int, COUNT] = 8
    """Control steps of each environment between two updates."""
    n_step: Annotated[int | None, COUNT] = None
    """n, rewards summed in a target (fewer at a rollout's end); None uses GAE."""
    gae_lambda: Annotated[float, SHARE] = 0.95
    """lambda of GAE, used where n_step is None: larger relies more on rewards."""
    entropy_coefficient: Annotated[float, NUMBER] = 0.002
    """c_H, weight of the entropy bonus."""


class A2C(OnPolicy):
    """A2C; see the module's docstring."""

    name = "a2c"
    Config = A2CConfig

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
        """Write the loss's gradient to `gradient`, of a rollout [N, T] with values."""
        terms = losses(self._loss(self._estimate(batch).reshape(-1)))
        self._differentiate(sum(terms.values()))
        return {name: term.item() for name, term in terms.items()}

    def load(self, other: "A2C") -> None:
        """Copy the parameters and the normalisation of another agent."""
        self._params.data.copy_(other._params.data)
        self.actor.norm.load_state_dict(other.actor.norm.state_dict())

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Take one step on the whole rollout [N, T]."""
        logged = self.differentiate(batch)
        self._step()
        return logged

    def _estimate(self, batch: TensorDictBase) -> TensorDictBase:
        if self.config.n_step is None:
            return self._gae(batch)
        n, gamma = self.config.n_step, self.config.gamma
        return n_step_advantages(batch, n, gamma, self.critic)


def _check_steps(config: A2CConfig) -> None:
    if config.n_step is not None and config.n_step > config.rollout_length:
        raise UserError(
            f"n_step is {config.n_step}, but a rollout has {config.rollout_length} "
            f"steps: set rollout_length to {config.n_step} or more"
        )
