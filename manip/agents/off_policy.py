"""Base of the algorithms that learn from a replay buffer (SAC, TD3, DQN).

Targets of n steps, with n > 1, use the rewards that older policies collected: they are
biased towards those policies (off-policy bias), which is not corrected. n = 1 has no
such bias, and learns slower.
"""

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.modules import ValueOperator

from manip.agents.agent import Agent, AgentConfig, Spaces
from manip.agents.networks import mlp
from manip.agents.replay import ImageTransitions, Replay
from manip.agents.trajectory import CPU
from manip.agents.value_targets import check_steps
from manip.io.option_ranges import COUNT, NUMBER, SHARE, WHOLE, Range
from manip.rewards.reward_function import RewardFunction


@dataclass(frozen=True)
class OffPolicyConfig(AgentConfig):
    """Options of all off-policy algorithms; defaults suit manipulation at 20 Hz."""

    gamma: Annotated[float, SHARE] = 0.95
    """Discount factor per control step: larger counts later rewards more."""
    n_step: Annotated[int, COUNT] = 3
    """Rewards summed in a critic's target before it bootstraps (n-step return), fewer
    at the end of a rollout: more of them rely less on the critic, and have more
    variance."""
    rollout_length: Annotated[int, COUNT] = 8
    """Control steps of each environment between two rounds of updates."""
    tau: Annotated[float, SHARE] = 0.01
    """Fraction by which targets move to the critics at each update (Polyak)."""
    learning_rate: Annotated[float, NUMBER] = 5e-4
    """Adam's step size, for all networks."""
    batch_size: Annotated[int, COUNT] = 256
    """Transitions per update (minibatch size)."""
    updates_per_step: Annotated[float, NUMBER] = 0.25
    """Critic updates per control step of one environment (update-to-data ratio)."""
    critic_hidden: Annotated[tuple[int, ...], COUNT] = (128, 128)
    """Widths of each critic's hidden layers (each with LayerNorm)."""
    buffer_size: Annotated[int, COUNT] = 400_000
    """Capacity of the replay buffer [control steps]."""
    random_steps: Annotated[int, WHOLE] = 4_000
    """Control steps with uniform random actions before learning starts
    (learning_starts)."""
    action_scale: Annotated[tuple[float, ...], Range(1e-6, 1)] = ()
    """Fraction of each action dimension's range that is used; 1 unless given."""
    gripper_bursts: Annotated[float, SHARE] = 0.0
    """Fraction of rollouts in which the gripper opens, or closes, in every step."""


class OffPolicy(Agent):
    """Store rollouts in a replay buffer, and learn from batches drawn from it.

    All rollouts must be of the same environments, in order of time.

    Args:
        device: where the buffers are.
    """

    off_policy = True
    image_copies = 2

    def __init__(
        self, config: OffPolicyConfig, spaces: Spaces, device: torch.device = CPU
    ) -> None:
        check_steps(config.n_step, config.rollout_length)
        self._options, self._spaces, self._device = config, spaces, device
        self.rollout_length = config.rollout_length
        self._replay = Replay(
            config.buffer_size,
            spaces.observation_dim,
            spaces.action_dim,
            spaces.inputs.cameras,
            device,
        )
        self._demonstrations: Replay | None = None
        self._steps = 0
        self._owed = 0.0
        self._updates = 0

    @property
    def replay(self) -> Replay:
        """The stored steps."""
        return self._replay

    @property
    def warming_up(self) -> bool:
        """Whether actions are still uniform and nothing is learned."""
        return self._steps < self._options.random_steps

    def _critic_alone(self, critic_steps: int) -> bool:
        """Whether the actor is not learned yet, `critic_steps` after the warm-up."""
        return self._steps < self._options.random_steps + critic_steps

    @property
    def _refilling(self) -> bool:
        """Whether the buffer is filled again, after a checkpoint without one."""
        options = self._options
        return len(self._replay) < min(options.random_steps, options.buffer_size)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Store the rollout [N, T]; then do as many updates as its steps call for."""
        self.store(batch)
        if self.warming_up or self._refilling:
            return {}
        self._owed += batch.numel() * self._options.updates_per_step
        logged: dict[str, float] = {}
        count, self._owed = int(self._owed), self._owed % 1
        for rows in self._sample(count):
            self._updates += 1
            logged |= self._learn(rows)
        return logged

    def store(self, batch: TensorDictBase) -> None:
        """Store the rollout [N, T]."""
        self._replay.add(batch)
        self._steps += batch.numel()

    def add_demonstrations(self, rollouts: Sequence[TensorDictBase]) -> None:
        """Take half of each batch from recorded episodes [1, T], as RLPD does (Ball et
        al. 2023, arXiv 2302.02948).
        """
        size = sum(rollout.numel() for rollout in rollouts)
        sizes = self._spaces.observation_dim, self._spaces.action_dim
        replay = Replay(size, *sizes, device=self._device)
        for rollout in rollouts:
            replay.add(rollout)
        self._demonstrations = replay

    def relabel(self, reward: RewardFunction) -> None:
        """Replace the reward of every stored step."""
        self._replay.relabel(reward)

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """Return the replay buffer and the counters."""
        return self._replay.state(buffer) | {
            "steps": self._steps,
            "owed": self._owed,
            "updates": self._updates,
        }

    def load_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what `extra_state` returned.

        Raises:
            ValueError: it is of a buffer of other sizes, or damaged.
        """
        self._replay.load_state(state)
        self._steps, self._owed = int(state["steps"]), float(state["owed"])
        self._updates = int(state["updates"])
        if min(self._steps, self._updates) < 0 or not 0 <= self._owed < 1:
            raise ValueError("the checkpoint's counters are out of range")

    @abstractmethod
    def _learn(self, rows: Any) -> dict[str, float]:
        """Learn from a batch of rows (see `rows_of`); `_updates` counts these calls.

        With cameras the batch is an `ImageTransitions`.
        """

    def _sample(self, batches: int) -> Iterable[Tensor | ImageTransitions]:
        """Draw the rows of so many batches at once; gather images batch by batch."""
        if not batches:
            return ()
        size, options = self._options.batch_size, self._options
        if self._demonstrations is not None:
            return self._sample_both(batches, self._demonstrations)
        rows, form = self._replay.draw(batches * size), (options.n_step, options.gamma)
        if not self._replay.cameras:
            return self._replay.transitions(rows, *form).split(size)
        return (
            self._replay.image_transitions(part, *form) for part in rows.split(size)
        )

    def _sample_both(self, batches: int, recorded: Replay) -> Iterator[Tensor]:
        """Batches of which one half is collected, the other recorded."""
        options = self._options
        form = options.n_step, options.gamma
        half = options.batch_size // 2
        for _ in range(batches):
            parts = [
                replay.transitions(replay.draw(count), *form)
                for replay, count in (
                    (self._replay, options.batch_size - half),
                    (recorded, half),
                )
            ]
            yield torch.cat(parts)


def descend(optimiser: torch.optim.Optimizer, loss: Tensor) -> None:
    """Step down the loss's gradient, computed by autograd."""
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()


def rows_of(transitions: TensorDictBase) -> Tensor:
    """Join transitions [B] to rows [B, 2 O + A + 3].

    Columns: state s, action, successor s', reward, number of steps from s to s', and
    whether the episode terminated there.
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


def transitions_of(rows: Tensor, observation_dim: int) -> TensorDict:
    """Split rows (see `rows_of`) into the keys that TorchRL's losses expect."""
    actions = rows.shape[1] - 2 * observation_dim - 3
    widths = (observation_dim, actions, observation_dim, 1, 1, 1)
    state, action, successor, reward, steps, terminated = rows.split(widths, 1)
    ended = terminated > 0
    after = {"observation": successor, "reward": reward}
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


def make_critics(
    count: int, spaces: Spaces, hidden: Sequence[int], device: torch.device = CPU
) -> ValueOperator | list[ValueOperator]:
    """Build critics Q(s, a); a list unless it is one (torchrl 0.14 needs it so)."""
    inputs, keys = spaces.observation_dim + spaces.action_dim, ["observation", "action"]
    critics = [
        ValueOperator(Critic(inputs, hidden).to(device), in_keys=keys)
        for _ in range(count)
    ]
    return critics if count > 1 else critics[0]


class Critic(torch.nn.Sequential):
    """Q(s, a) from observation and action, concatenated."""

    def __init__(self, inputs: int, hidden: Sequence[int]) -> None:
        super().__init__(*mlp(inputs, 1, hidden, layer_norm=True))

    def forward(self, *parts: Tensor) -> Tensor:
        """Map observation [B, D] and action [B, A] to values [B, 1]."""
        return super().forward(torch.cat(parts, -1))
