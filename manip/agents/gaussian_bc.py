"""Behaviour cloning of varied demonstrations by likelihood: a policy with a spread.

    actor: max E log N(a; mu(s), sigma),  (s, a) ~ varied episodes of the expert

The demonstrations vary as those of people do: in each environment and each rollout, the
expert's motion is multiplied by a factor (haste), the hand turns in addition (wrist),
and each action has noise. The clone's Gaussian covers them: what to prefer among them
is left to be learned (see `manip.agents.ppo_kl`). In contrast to `bc`, it learns the
actions that were done, not those that the expert would have done.
"""

from dataclasses import dataclass
from typing import Annotated, Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.modules import IndependentNormal

from manip.agents.agent import Agent, AgentConfig, Spaces
from manip.agents.networks import Actor, RunningNorm, seeded_generator
from manip.agents.off_policy import descend
from manip.agents.replay import Replay
from manip.errors import UserError
from manip.io.option_ranges import COUNT, NUMBER, SHARE


@dataclass(frozen=True)
class GaussianBCConfig(AgentConfig):
    """Options of behaviour cloning by likelihood."""

    haste: Annotated[tuple[float, ...], SHARE] = (0.5, 1.0)
    """Least and greatest factor of the expert's motion: less moves slower."""
    wrist: Annotated[float, SHARE] = 0.03
    """Standard deviation of the additional turn of the hand, a fraction of the range of
    the rotations."""
    noise: Annotated[float, NUMBER] = 0.1
    """Standard deviation of the noise of each action."""
    rollout_length: Annotated[int, COUNT] = 32
    """Control steps of each environment between two rounds of updates, and until haste
    and turn are drawn anew."""
    updates_per_step: Annotated[float, NUMBER] = 0.1
    """Updates per control step of one environment."""
    batch_size: Annotated[int, COUNT] = 256
    """Steps per update (minibatch size)."""
    learning_rate: Annotated[float, NUMBER] = 1e-3
    """Adam's step size."""
    actor_hidden: Annotated[tuple[int, ...], COUNT] = (128, 128)
    """Widths of the actor's hidden layers."""
    buffer_size: Annotated[int, COUNT] = 200_000
    """Capacity of the buffer of demonstrated steps [control steps]."""


class VariedExpert(TensorDictModuleBase):
    """Act as the task's expert, varied for a rollout; see the module's docstring."""

    in_keys = ["expert_action"]
    out_keys = ["action"]

    def __init__(self, config: GaussianBCConfig) -> None:
        super().__init__()
        self._config, self._generator = config, seeded_generator()
        self._haste = self._turn = torch.empty(0)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A]: of OSC_POSE, translation, rotation and gripper."""
        action = tensordict["expert_action"].clone()
        if not len(self._haste):
            self._vary(len(action))
        action[:, :3] *= self._haste
        action[:, 3:6] += self._turn
        noise = torch.randn(action.shape, generator=self._generator)
        action += self._config.noise * noise
        return tensordict.set("action", action.clamp(-1, 1))

    def _vary(self, num_envs: int) -> None:
        low, high = self._config.haste
        unit = torch.rand(num_envs, 1, generator=self._generator)
        self._haste = low + (high - low) * unit
        turn = torch.randn(num_envs, 3, generator=self._generator)
        self._turn = self._config.wrist * turn


class GaussianBC(Agent):
    """Behaviour cloning by likelihood; see the module's docstring."""

    name = "gaussian-bc"
    Config = GaussianBCConfig
    off_policy = True
    imitates = True
    actor: Actor

    def __init__(
        self, config: GaussianBCConfig, spaces: Spaces, threads: int = 1
    ) -> None:
        _check_haste(config.haste)
        self.config, self.rollout_length = config, config.rollout_length
        dims = spaces.observation_dim, spaces.action_dim
        self.actor = Actor(*dims, config.actor_hidden, squash=False, normalise=True)
        rate = config.learning_rate
        self._optim = torch.optim.Adam(self.actor.parameters(), rate, fused=True)
        self._replay = Replay(config.buffer_size, *dims)
        self._owed = 0.0

    def policy(self) -> TensorDictModuleBase:
        """Return the varied expert."""
        return VariedExpert(self.config)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Store the rollout [N, T]; then do as many updates as its steps call for."""
        assert isinstance(self.actor.norm, RunningNorm)
        self.actor.norm.update(batch["observation"])
        self._replay.add(batch)
        self._owed += batch.numel() * self.config.updates_per_step
        count, self._owed = int(self._owed), self._owed % 1
        losses = [self._learn() for _ in range(count)]
        return {"loss_actor": sum(losses) / count} if losses else {}

    def _learn(self) -> float:
        drawn = self._replay.draw(self.config.batch_size)
        rows = self._replay.transitions(drawn, 1, 0.0)
        sizes = self.actor.observation_dim, len(self.actor.action_scale)
        observation, action, _ = rows.split([*sizes, rows.shape[1] - sum(sizes)], 1)
        policy = IndependentNormal(*self.actor(observation))
        loss = -policy.log_prob(action).mean()
        descend(self._optim, loss)
        return loss.item()

    def modules(self) -> dict[str, nn.Module]:
        """Return the actor."""
        return {"actor": self.actor}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Return one for the actor."""
        return {"actor": self._optim}

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """Return the stored steps, and the updates owed."""
        return self._replay.state(buffer) | {"owed": self._owed}

    def load_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what `extra_state` returned.

        Raises:
            ValueError: it is of another buffer, or damaged.
        """
        self._replay.load_state(state)
        self._owed = float(state["owed"])
        if not 0 <= self._owed < 1:
            raise ValueError("the checkpoint's counters are out of range")


def _check_haste(haste: tuple[float, ...]) -> None:
    if len(haste) != 2 or haste[0] > haste[1]:
        raise UserError(
            f"agent.haste must be a least and a greatest factor, not {haste}"
        )
