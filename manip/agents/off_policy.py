"""What the algorithms share that learn from all they have seen."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Generator, Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import ValueOperator

from manip.agents.agent import Agent, Spaces
from manip.agents.networks import Actor, BinnedActor, mlp, seeded
from manip.agents.value_targets import n_step_transitions


@dataclass(frozen=True)
class OffPolicyConfig:
    """Options that all of them have; defaults suit manipulation at 20 Hz."""

    gamma: float = 0.95
    """Discount a control step."""
    n_step: int = 3
    """Rewards that a critic's target sums up before it relies on the critics."""
    rollout_length: int = 8
    """Control steps of every world between two rounds of updates."""
    tau: float = 0.01
    """Share of the critics that goes into their targets at each update."""
    learning_rate: float = 5e-4
    """Adam's step size, for all that is learned."""
    batch_size: int = 256
    """Transitions an update."""
    updates_per_step: float = 0.25
    """Critic updates for each control step of each world."""
    critic_hidden: tuple[int, ...] = (128, 128)
    """Widths of each critic's hidden layers (each with LayerNorm)."""
    buffer_size: int = 400_000
    """Transitions that are kept."""
    random_steps: int = 4_000
    """Steps with uniform actions before learning starts."""
    action_scale: tuple[float, ...] = ()
    """Part of each OSC_POSE action's range that is used; all of it unless given."""
    gripper_bursts: float = 0.0
    """Share of a rollout's worlds whose gripper opens, or closes, all through it."""


Explore = Callable[[Any, Tensor, Generator], Tensor]
"""(actor, observation [N, D], random numbers) -> action [N, A] / action_scale."""


BURST = 0.9
"""Gripper command of a burst: inside the range, where tanh has an inverse."""


class RolloutPolicy(TensorDictModuleBase):
    """Explores with a copy of the actor; uniform actions to `warm_up`.

    A gripper takes ten steps from closed to open. Noise of single steps does not let go
    of what an actor wants to hold; with `bursts`, a share of the worlds does.
    """

    in_keys = ["observation"]
    out_keys = ["action"]

    def __init__(
        self,
        actor: Actor | BinnedActor,
        explore: Explore,
        warm_up: bool = False,
        bursts: float = 0.0,
    ) -> None:
        super().__init__()
        self._actor, self._warm_up, self._bursts = deepcopy(actor), warm_up, bursts
        self._explore, self._generator = explore, seeded()
        self._forced: Tensor | None = None

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A]."""
        unit = self._draw(tensordict["observation"])
        if self._forced is None:
            self._forced = self._draw_bursts(len(unit))
        unit[:, -1] = self._forced.where(self._forced != 0, unit[:, -1])
        return tensordict.set("action", self._actor.action_scale * unit)

    def _draw(self, observation: Tensor) -> Tensor:
        if self._warm_up:
            shape = (len(observation), len(self._actor.action_scale))
            return torch.rand(shape, generator=self._generator) * 2 - 1
        return self._explore(self._actor, observation, self._generator)

    def _draw_bursts(self, worlds: int) -> Tensor:
        """[N] the gripper's command for the whole rollout; 0 leaves it to the actor."""
        unit = torch.rand(worlds, generator=self._generator)
        command = torch.where(unit < self._bursts / 2, BURST, -BURST)
        return command * (unit < self._bursts)


class OffPolicy(Agent):
    """Collect, store, and learn from transitions drawn from all that is stored."""

    off_policy = True

    def __init__(self, config: OffPolicyConfig) -> None:
        self._options = config
        self.rollout_length = config.rollout_length
        self._buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.buffer_size)
        )
        self._seen = 0
        self._owed = 0.0
        self._updates = 0

    @property
    def warming_up(self) -> bool:
        """Nothing is learned yet."""
        return self._seen < self._options.random_steps

    @property
    def _refilling(self) -> bool:
        """The run goes on from a checkpoint without a buffer."""
        options = self._options
        return len(self._buffer) < min(options.random_steps, options.buffer_size)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Store the rollout [N, T]; then as many updates as its steps call for."""
        config = self._options
        flat = n_step_transitions(batch, config.n_step, config.gamma).reshape(-1)
        self._buffer.extend(TensorDict({"row": rows_of(flat)}, flat.batch_size))
        self._seen += len(flat)
        if self.warming_up or self._refilling:
            return {}
        self._owed += len(flat) * config.updates_per_step
        logged: dict[str, float] = {}
        count, self._owed = int(self._owed), self._owed % 1
        for rows in self._sample(count):
            self._updates += 1
            logged |= self._learn(rows)
        return logged

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """The buffer's transitions, oldest place first, and the counters."""
        kept = buffer and len(self._buffer) > 0
        return {
            "buffer": self._buffer[:]["row"] if kept else None,
            "cursor": self._buffer.writer._cursor if kept else 0,
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

    @abstractmethod
    def _learn(self, rows: Tensor) -> dict[str, float]:
        """Learn from a batch of rows (see `rows_of`); `_updates` counts these calls."""

    def _sample(self, batches: int) -> Sequence[Tensor]:
        size = self._options.batch_size
        if not batches:
            return ()
        return self._buffer.sample(batches * size)["row"].split(size)


def descend(optimiser: torch.optim.Optimizer, loss: Tensor) -> None:
    """A step down the loss's gradient, as autograd finds it."""
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()


def rows_of(transitions: TensorDictBase) -> Tensor:
    """Transitions [B] as rows [B, 2 O + A + 3]: state s, action, successor s', reward,
    number of steps from s to s', and whether the episode terminated there.
    """
    after = transitions["next"]
    parts = [
        transitions["observation"],
        transitions["action"],
        after["observation"],
        after["reward"],
        transitions["steps_to_next_obs"],
        after["terminated"],
    ]
    return torch.cat([part.float() for part in parts], -1)


def transitions_of(rows: Tensor, states: int) -> TensorDict:
    """What `rows_of` made rows of, from `states` numbers a state."""
    actions = rows.shape[1] - 2 * states - 3
    widths = (states, actions, states, 1, 1, 1)
    state, action, following, reward, steps, terminated = rows.split(widths, 1)
    ended = terminated > 0
    after = {"observation": following, "reward": reward}
    after |= {"terminated": ended, "done": ended}
    return TensorDict(
        {
            "observation": state,
            "action": action,
            "steps_to_next_obs": steps,
            "next": TensorDict(after, rows.shape[:1]),
        },
        rows.shape[:1],
    )


def critics_of(
    count: int, spaces: Spaces, hidden: Sequence[int]
) -> ValueOperator | list[ValueOperator]:
    """So many critics, or the one (torchrl 0.14 cannot optimise a list of one)."""
    inputs, keys = spaces.observation_dim + spaces.action_dim, ["observation", "action"]
    critics = [
        ValueOperator(Critic(inputs, hidden), in_keys=keys) for _ in range(count)
    ]
    return critics if count > 1 else critics[0]


class Critic(nn.Sequential):
    """Q(s, a) from observation and action, concatenated."""

    def __init__(self, inputs: int, hidden: Sequence[int]) -> None:
        super().__init__(*mlp(inputs, 1, hidden, layer_norm=True))

    def forward(self, *parts: Tensor) -> Tensor:
        """parts: [B, D], [B, A] -> [B, 1]."""
        return super().forward(torch.cat(parts, -1))
