"""Advantage-weighted regression (Peng et al. 2019, arXiv 1910.00177).

    critic: min (V(s) - R)^2,  R = A + V by GAE(lambda)
    actor:  min -exp(A / beta) log pi(a | s)

Actions that turned out better than V are imitated, the more the better they were.
"""

from dataclasses import dataclass
from typing import Annotated

from tensordict import TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.objectives import LossModule
from torchrl.objectives.value import GAE

from manip.agents.agent import Spaces
from manip.agents.on_policy import OnPolicy, OnPolicyConfig, losses, minibatches
from manip.io.option_ranges import COUNT, POSITIVE, SHARE


@dataclass(frozen=True)
class AWRConfig(OnPolicyConfig):
    """Options of advantage-weighted regression."""

    gae_lambda: Annotated[float, SHARE] = 0.95
    """lambda of GAE: larger relies more on rewards, less on the critic."""
    beta: Annotated[float, POSITIVE] = 0.3
    """Temperature: smaller imitates only the best actions."""
    epochs: Annotated[int, COUNT] = 4
    """Passes over each rollout."""


class AWRLoss(LossModule):
    """The two losses, on samples with `advantage` and `value_target`."""

    actor_network: TensorDictModule
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams
    critic_network: TensorDictModule
    critic_network_params: TensorDictParams
    target_critic_network_params: TensorDictParams

    def __init__(
        self, actor: TensorDictModule, critic: TensorDictModule, beta: float
    ) -> None:
        super().__init__()
        self.convert_to_functional(actor, "actor_network")
        self.convert_to_functional(critic, "critic_network")
        self.beta = beta

    def forward(self, samples: TensorDictBase) -> TensorDict:
        """Return `loss_actor` and `loss_critic`."""
        state = samples.select("observation")
        with self.critic_network_params.to_module(self.critic_network):
            value = self.critic_network(state)["state_value"]
        critic = (value - samples["value_target"]).square().mean()
        weight = (samples["advantage"] / self.beta).clamp(max=3.0).exp().squeeze(-1)
        actor = -(weight * self._log_prob(state, samples["action"])).mean()
        return TensorDict({"loss_actor": actor, "loss_critic": critic})

    def _log_prob(self, state: TensorDictBase, action: Tensor) -> Tensor:
        with self.actor_network_params.to_module(self.actor_network):
            return self.actor_network.get_dist(state).log_prob(action)


class AWR(OnPolicy):
    """Advantage-weighted regression; see the module's docstring."""

    name = "awr"
    Config = AWRConfig

    def __init__(self, config: AWRConfig, spaces: Spaces, threads: int = 1) -> None:
        self.config = config
        super().__init__(config, spaces)
        self._gae = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=None)

    def _make_loss(self) -> AWRLoss:
        return AWRLoss(self.stochastic, self.critic, self.config.beta)

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        samples = self._gae(batch).reshape(-1)
        for _ in range(self.config.epochs):
            for piece in minibatches(samples, 8):
                terms = losses(self._loss(piece))
                self._descend(sum(terms.values()))
        return {name: term.item() for name, term in terms.items()}
