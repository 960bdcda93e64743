"""Soft actor-critic (Haarnoja et al. 2018, arXiv 1812.05905), on TorchRL's SACLoss.

    critic:      min (Q_i(s, a) - y)^2,
                 y = r + gamma r' + ... + gamma^n (1 - terminated) V(s')
                 V(s') = min_i Q'_i(s', a') - alpha log pi(a' | s'),  a' ~ pi(. | s')
    actor:       min alpha log pi(a | s) - min_i Q_i(s, a),  a ~ pi(. | s)
    temperature: min -log(alpha) (log pi(a | s) + target entropy)

s' is n steps on; Q' is the exponential average of Q. A time limit is no termination:
y bootstraps through it. What is deployed is the exponential average of the actor
(Polyak and Juditsky 1992): neighbouring actors differ by 10 % of success and more.
"""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torch.optim import Adam
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss

from manip.agents.agent import Agent, Spaces
from manip.agents.flat import flatten
from manip.agents.networks import Actor, mlp, seeded
from manip.agents.returns import n_step_transitions
from manip.agents.sac_gradients import flatten_loss, rows_of, sac_gradients


@dataclass(frozen=True)
class SACConfig:
    """Options of SAC; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    gamma: float = 0.95
    """Discount a control step."""
    n_step: int = 3
    """Rewards that a critic's target sums up before it relies on the critics."""
    rollout_length: int = 8
    """Control steps of every world between two rounds of updates."""
    tau: float = 0.01
    """Share of the critics that goes into their targets at each update."""
    learning_rate: float = 5e-4
    """Adam's step size, for actor, critics and temperature."""
    batch_size: int = 256
    """Transitions an update."""
    updates_per_step: float = 0.25
    """Critic updates for each control step of each world."""
    actor_delay: int = 2
    """Critic updates for each update of the actor and the temperature."""
    actor_average: float = 0.005
    """Share of the actor that goes into the deployed one at each of its updates."""
    actor_hidden: tuple[int, ...] = (128, 128)
    """Widths of the actor's hidden layers."""
    critic_hidden: tuple[int, ...] = (128, 128)
    """Widths of each critic's hidden layers (each with LayerNorm)."""
    initial_alpha: float = 0.1
    """Temperature at the start."""
    target_entropy: float = -3.5
    """Entropy [nat] that the temperature aims at, of actions in [-1, 1]."""
    buffer_size: int = 400_000
    """Transitions that are kept."""
    random_steps: int = 4_000
    """Steps with uniform actions before learning starts."""
    action_scale: tuple[float, ...] = ()
    """Part of each OSC_POSE action's range that is used; all of it unless given."""
    gripper_bursts: float = 0.0
    """Share of a rollout's worlds whose gripper opens, or closes, all through it."""


BURST = 0.9
"""Gripper command of a burst: inside the range, where tanh has an inverse."""


class RolloutPolicy(TensorDictModuleBase):
    """Samples a copy of the actor for exploration; uniform actions to `warm_up`.

    A gripper takes ten steps from closed to open. Noise of single steps does not let go
    of what an actor wants to hold; with `bursts`, a share of the worlds does.
    """

    in_keys = ["observation"]
    out_keys = ["action"]

    def __init__(self, actor: Actor, warm_up: bool, bursts: float = 0.0) -> None:
        super().__init__()
        self._actor, self._warm_up, self._bursts = deepcopy(actor), warm_up, bursts
        self._generator = seeded()
        self._forced: Tensor | None = None

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A]."""
        action = self._sample(tensordict["observation"])
        if self._forced is None:
            self._forced = self._draw_bursts(len(action))
        action[:, -1] = self._forced.where(self._forced != 0, action[:, -1])
        return tensordict.set("action", action)

    def _sample(self, observation: Tensor) -> Tensor:
        loc, scale = self._actor(observation)
        if self._warm_up:
            uniform = torch.rand(loc.shape, generator=self._generator) * 2 - 1
            return self._actor.action_scale * uniform
        noise = torch.randn(loc.shape, generator=self._generator)
        return self._actor.squashed(loc + scale * noise)

    def _draw_bursts(self, worlds: int) -> Tensor:
        """[N] the gripper's command for the whole rollout; 0 leaves it to the actor."""
        unit = torch.rand(worlds, generator=self._generator)
        command = torch.where(unit < self._bursts / 2, BURST, -BURST)
        return command * (unit < self._bursts)


class SAC(Agent):
    """SAC on TorchRL; see the module's docstring."""

    off_policy = True

    def __init__(self, config: SACConfig, spaces: Spaces, threads: int = 1) -> None:
        self.config = config
        self.rollout_length = config.rollout_length
        self.explorer = Actor(
            spaces.observation_dim,
            spaces.action_dim,
            config.actor_hidden,
            squash=True,
            normalise=False,
            action_scale=config.action_scale,
        )
        self.actor = deepcopy(self.explorer)
        self._deployed = flatten([*self.actor.body.parameters()]).data
        self._loss = _loss(config, spaces, self.explorer)
        self._params = flatten_loss(self._loss, self.explorer)
        self._gradients = sac_gradients(
            self._loss,
            self._params,
            self.explorer,
            config.gamma,
            config.batch_size,
            threads,
        )
        self._buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.buffer_size)
        )
        rate = config.learning_rate
        self._critic_optim = Adam([self._params.critics], rate, fused=True)
        self._actor_optim = Adam([self._params.actor], rate, fused=True)
        self._seen = 0
        self._owed = 0.0
        self._updates = 0

    def policy(self) -> TensorDictModuleBase:
        """Uniform at first, then samples of the actor."""
        warm_up = self._seen < self.config.random_steps
        return RolloutPolicy(self.explorer, warm_up, self.config.gripper_bursts)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Store the rollout [N, T]; then as many updates as its steps call for."""
        config = self.config
        flat = n_step_transitions(batch, config.n_step, config.gamma).reshape(-1)
        self._buffer.extend(TensorDict({"row": rows_of(flat)}, flat.batch_size))
        self._seen += len(flat)
        if self._seen < config.random_steps:
            return {}
        self._owed += len(flat) * config.updates_per_step
        logged: dict[str, float] = {}
        count, self._owed = int(self._owed), self._owed % 1
        for rows in self._sample(count):
            logged |= self._learn(rows)
        return logged

    def modules(self) -> dict[str, nn.Module]:
        """The deployed actor; the loss holds the others, and the temperature."""
        return {"actor": self.actor, "loss": self._loss}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """One for the critics, one for actor and temperature."""
        return {"critic": self._critic_optim, "actor": self._actor_optim}

    def extra_state(self) -> dict[str, Any]:
        """The buffer's transitions, oldest place first, and the counters."""
        return {
            "buffer": self._buffer[:]["row"] if len(self._buffer) else None,
            "cursor": self._buffer.writer._cursor,
            "seen": self._seen,
            "owed": self._owed,
            "updates": self._updates,
        }

    def load_extra_state(self, state: dict[str, Any]) -> None:
        """Refill the buffer in the same order."""
        rows = state["buffer"]
        if rows is not None:
            self._buffer.extend(TensorDict({"row": rows}, rows.shape[:1]))
        self._buffer.writer._cursor = state["cursor"]
        self._seen, self._owed = state["seen"], state["owed"]
        self._updates = state["updates"]

    def _sample(self, batches: int) -> Sequence[Tensor]:
        size = self.config.batch_size
        if not batches:
            return ()
        return self._buffer.sample(batches * size)["row"].split(size)

    def _learn(self, rows: Tensor) -> dict[str, float]:
        self._updates += 1
        loss = self._gradients.critic(rows)
        self._critic_optim.step()
        self._params.targets.data.lerp_(self._params.critics.data, self.config.tau)
        if self._updates % self.config.actor_delay:
            return {}
        return {"loss_critic": loss, **self._improve(rows)}

    def _improve(self, rows: Tensor) -> dict[str, float]:
        loss, log_prob = self._gradients.actor(rows)
        self._actor_optim.step()
        latest = self._params.actor.data[:-1]
        self._deployed.lerp_(latest, self.config.actor_average)
        alpha = self._params.actor.data[-1].exp().item()
        return {"loss_actor": loss, "alpha": alpha, "entropy": -log_prob}


def _loss(config: SACConfig, spaces: Spaces, actor: Actor) -> SACLoss:
    stochastic = ProbabilisticActor(
        TensorDictModule(actor, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -actor.action_scale, "high": actor.action_scale},
        return_log_prob=True,
    )
    inputs = spaces.observation_dim + spaces.action_dim
    critics = [
        ValueOperator(
            _Critic(inputs, config.critic_hidden), in_keys=["observation", "action"]
        )
        for _ in range(2)
    ]
    loss = SACLoss(
        stochastic,
        critics,
        loss_function="l2",
        alpha_init=config.initial_alpha,
        target_entropy=config.target_entropy + actor.action_scale.log().sum().item(),
    )
    loss.make_value_estimator(gamma=config.gamma)
    return loss


class _Critic(nn.Sequential):
    """Q(s, a) from observation and action, concatenated."""

    def __init__(self, inputs: int, hidden: tuple[int, ...]) -> None:
        super().__init__(*mlp(inputs, 1, hidden, layer_norm=True))

    def forward(self, *parts: Tensor) -> Tensor:
        return super().forward(torch.cat(parts, -1))
