"""Native gradients of SAC and PPO with an error planted in one part."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from manip.agents.agent import Spaces
from manip.agents.native import ppo_gradients, sac_gradients
from manip.agents.ppo import PPO, PPOConfig
from manip.agents.sac import SAC, SACConfig

SPACES = Spaces(observation_dim=5, action_dim=3)
HIDDEN = {"actor_hidden": (16, 12), "critic_hidden": (12, 16)}
SMALL = {
    "sac": SACConfig(batch_size=200, **HIDDEN),
    "ppo": PPOConfig(**HIDDEN),
}
BY_ONE_PERCENT = 1.01


def make_agent(algorithm: str, seed: int = 0, **options: Any) -> SAC | PPO:
    torch.manual_seed(seed)
    agent = {"sac": SAC, "ppo": PPO}[algorithm]
    return agent(SMALL[algorithm], SPACES, **options)


def gradient_names(agent: SAC | PPO) -> list[str]:
    """Return the names of all gradients and reported numbers that are compared."""
    check = agent._gradients
    width = {"SAC": 2 * 5 + 3 + 3, "PPO": 5 + 3 + 3}[type(agent).__name__]
    return [*check._measure(check.in_use, torch.rand(200, width))]


def recheck(agent: SAC | PPO, native: Any) -> bool:
    """Return whether the start check finds other native gradients right."""
    check = agent._gradients
    if isinstance(agent, SAC):
        fresh = sac_gradients.CheckedGradients(
            native, check._reference, agent._params, agent.explorer, 200
        )
    else:
        clip = check._native.clip
        fresh = ppo_gradients.CheckedGradients(
            native, check._reference, agent.actor, agent.critic, clip
        )
    return fresh.in_use is native


class ScaledResult:
    """Native gradients, one gradient or number of which is 1 % too large."""

    def __init__(self, agent: SAC | PPO, name: str) -> None:
        self._native, self._name = agent._gradients._native, name
        self._views = agent._params.gradients if isinstance(agent, SAC) else {}
        self._params = getattr(agent._gradients, "_params", {})

    def __call__(self, rows: Tensor) -> Any:
        stats = self._native(rows)
        if self._name in self._params:
            self._params[self._name].grad.mul_(BY_ONE_PERCENT)
            return stats
        number = getattr(stats, self._name) * BY_ONE_PERCENT
        return stats._replace(**{self._name: number})

    def critic(self, rows: Tensor) -> float:
        loss = self._native.critic(rows)
        self._scale("critic")
        return loss * BY_ONE_PERCENT if self._name == "loss_critic" else loss

    def actor(self, rows: Tensor) -> tuple[float, float]:
        loss, log_prob = self._native.actor(rows)
        if not self._name.startswith("critic"):
            self._scale("")
        numbers = {"loss_actor": loss, "log_prob": log_prob}
        if self._name in numbers:
            numbers[self._name] *= BY_ONE_PERCENT
        return numbers["loss_actor"], numbers["log_prob"]

    def _scale(self, prefix: str) -> None:
        if self._name in self._views and self._name.startswith(prefix):
            self._views[self._name].mul_(BY_ONE_PERCENT)


class ScaledInputs:
    """Native gradients from inputs that are changed first.

    Args:
        nets: changes the networks and constants.
        rows: changes a copy of the rows in place.
    """

    def __init__(
        self,
        agent: SAC | PPO,
        nets: Callable[[Any], Any] = lambda nets: nets,
        rows: Callable[[Tensor], Any] = lambda rows: None,
    ) -> None:
        self._native = agent._gradients._native
        self._change_nets, self._change_rows = nets, rows

    def __call__(self, rows: Tensor) -> Any:
        return self._run(self._native, rows)

    def critic(self, rows: Tensor) -> float:
        return self._run(self._native.critic, rows)

    def actor(self, rows: Tensor) -> tuple[float, float]:
        return self._run(self._native.actor, rows)

    def _run(self, gradients: Callable[[Tensor], Any], rows: Tensor) -> Any:
        rows, nets = rows.clone(), self._native._nets
        self._change_rows(rows)
        self._native._nets = self._change_nets(nets)
        try:
            return gradients(rows)
        finally:
            self._native._nets = nets
