"""REINFORCE (Williams 1992, doi 10.1007/BF00992696), with TorchRL's ReinforceLoss.

    actor:  max E log pi(a_t | s_t) (R_t - b(s_t))
    R_t   = r_t + gamma r_{t+1} + ... to the episode's end (return-to-go)
    critic: min c_V (V(s_t) - R_t)^2

The baseline b is V, or zero: both have the same mean gradient, and V has less variance.
Where a time limit or the rollout's end cuts the sum, gamma^k V(s_{t+k}) replaces its
rest.
"""

from dataclasses import dataclass

from tensordict import TensorDictBase
from torchrl.objectives import ReinforceLoss
from torchrl.objectives.value import GAE

from manip.agents.agent import Spaces
from manip.agents.on_policy import OnPolicy, OnPolicyConfig


@dataclass(frozen=True)
class ReinforceConfig(OnPolicyConfig):
    """Options of REINFORCE; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    baseline: bool = True
    """Subtract V(s) from the returns: less variance, the same mean gradient."""


class Reinforce(OnPolicy):
    """REINFORCE; see the module's docstring."""

    name = "reinforce"
    Config = ReinforceConfig

    def __init__(
        self, config: ReinforceConfig, spaces: Spaces, threads: int = 1
    ) -> None:
        self.config = config
        super().__init__(config, spaces)
        self._returns = GAE(gamma=config.gamma, lmbda=1.0, value_network=None)

    def _make_loss(self) -> ReinforceLoss:
        return ReinforceLoss(self.stochastic, self.critic, loss_critic_type="l2")

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Take one step on the whole rollout [N, T]."""
        samples = self._returns(batch).reshape(-1)
        if not self.config.baseline:
            samples["advantage"] = samples["value_target"]
        terms = self._loss(samples)
        critic = self.config.critic_coefficient * terms["loss_value"]
        self._descend(terms["loss_actor"] + critic)
        return {
            "loss_objective": terms["loss_actor"].item(),
            "loss_critic": critic.item(),
        }
