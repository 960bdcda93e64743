"""Replay buffer of single steps; n-step transitions are formed when sampled.

A ring of rows, one for each control step. Each row has a link to the row of the next
step of its episode in the same rollout, or NONE. A row is overwritten before any row
that it links to, so a link never leads to foreign data.

Sums end with the rollout, and bootstrap there, although the next rollout is stored as
well. With sums across rollouts of 8 steps (n = 3), SAC learned Lift less well: success
was held in 96, 98, 88 and 96 % of 300 episodes (seeds 20 to 23), against 98, 99, 98 and
97 % with sums that end.

Rows are relabelled or sampled with another n or discount without new experience.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from manip.agents.replay_columns import (
    NONE,
    OPTIONAL,
    allocate,
    check_columns,
    check_links,
    image_after,
    image_before,
)
from manip.agents.trajectory import CPU, episode_starts, numbers_after, placed
from manip.errors import UserError
from manip.observation import ObservationPart
from manip.rewards.reward_function import RewardFunction


class ImageTransitions(NamedTuple):
    """A batch of n-step transitions with images.

    Attributes:
        rows: [B, 2 O + A + 3], see `Replay.transitions`.
        images: camera part -> uint8 [B, H, W, C] at s.
        successors: the same at s'.
    """

    rows: Tensor
    images: dict[str, Tensor]
    successors: dict[str, Tensor]


class Replay:
    """Ring buffer of the latest `capacity` control steps.

    Columns, S = capacity: `before` [S, O + A] observation and action, `after` [S, O]
    next observation, `reward` [S], `terminated` [S], `ended` [S], `terms` [S, K] raw
    reward terms, `measures` [S, M] visible measures, `env` [S], `episode` [S] a number
    for each episode, `link` [S]; and for each camera its image before and after the
    step, uint8 [S, H, W, C]. K and M are 0 where rollouts have none.

    Args:
        capacity: most steps that are stored.
        observation_dim: O.
        action_dim: A.
        cameras: parts of the observation that are images.
        device: where the columns are.

    Attributes:
        cameras: their names.

    Raises:
        UserError: there is not enough memory.
    """

    def __init__(
        self,
        capacity: int,
        observation_dim: int,
        action_dim: int,
        cameras: Sequence[ObservationPart] = (),
        device: torch.device = CPU,
    ) -> None:
        self.capacity, self._device = capacity, device
        self._widths = observation_dim, action_dim
        self.cameras = tuple(camera.name for camera in cameras)
        self._columns = allocate(capacity, *self._widths, cameras, device)
        self._size = self._cursor = self._episodes = 0
        self._current = torch.empty(0, dtype=torch.int64, device=device)

    def __len__(self) -> int:
        """Number of steps stored."""
        return self._size

    def add(self, batch: TensorDictBase) -> None:
        """Append a rollout [N, T] that continues the last one (see trajectory).

        Raises:
            UserError: the rollout is longer than the buffer.
        """
        count = batch.numel()
        if count > self.capacity:
            raise UserError(
                f"buffer_size is {self.capacity}, but a rollout has {count} steps: set "
                f"agent.buffer_size to {count} or more"
            )
        batch = placed(batch, self._device)
        self._prepare(batch)
        numbers = torch.arange(count, device=self._device)
        rows = (numbers + self._cursor) % self.capacity
        ended = batch["next", "done"].squeeze(-1)
        self._write(rows, batch, self._number_episodes(ended))
        self._link(rows.view(batch.shape), ended)
        self._cursor = (self._cursor + count) % self.capacity
        self._size = min(self._size + count, self.capacity)

    def draw(self, count: int) -> Tensor:
        """Draw the numbers of stored rows uniformly, with replacement."""
        return torch.randint(self._size, (count,), device=self._device)

    def transitions(self, rows: Tensor, n: int, gamma: float) -> Tensor:
        """Form the transitions of up to n steps that begin at the given rows.

            R = r_t + gamma r_{t+1} + ... + gamma^(m-1) r_{t+m-1},
            s' = s_{t+m},  m = min(n, steps to the end of the episode or rollout)

        Returns:
            [B, 2 O + A + 3]: observation, action, s', R, m, whether s' is terminal.
        """
        return self._transitions(rows, n, gamma)[0]

    def image_transitions(self, rows: Tensor, n: int, gamma: float) -> ImageTransitions:
        """The same with the images at s and s'."""
        vectors, last = self._transitions(rows, n, gamma)
        return ImageTransitions(
            vectors,
            {name: self._take(image_before(name), rows) for name in self.cameras},
            {name: self._take(image_after(name), last) for name in self.cameras},
        )

    def _transitions(self, rows: Tensor, n: int, gamma: float) -> tuple[Tensor, Tensor]:
        """Transitions [B, ...], and the row [B] of each one's last step."""
        take = self._take
        last, total = rows, take("reward", rows)
        steps = torch.ones_like(total)
        for k in range(1, n):
            following = take("link", last)
            goes_on = following != NONE
            last = torch.where(goes_on, following, last)
            total = total + gamma**k * goes_on * take("reward", last)
            steps += goes_on
        ends = [total, steps, take("terminated", last).float()]
        parts = [take("before", rows), take("after", last), torch.stack(ends, 1)]
        return torch.cat(parts, 1), last

    def _take(self, name: str, rows: Tensor) -> Tensor:
        """Gather rows of a column; index_select takes a seventh of column[rows]."""
        return self._columns[name].index_select(0, rows)

    def steps(self) -> TensorDictBase:
        """View the stored steps as rollouts [S, 1] of one step each."""
        column = {name: c[: self._size, None] for name, c in self._columns.items()}
        observation, action = column["before"].split(self._widths, -1)
        after = {
            "observation": column["after"],
            "reward": column["reward"][..., None],
            "reward_terms": column["terms"],
            "measures": column["measures"],
            "terminated": column["terminated"][..., None],
            "done": column["ended"][..., None],
        }
        shape = (self._size, 1)
        return TensorDict(
            {
                "observation": observation,
                "action": action,
                "env": column["env"],
                "episode": column["episode"],
                "next": TensorDict(after, shape),
            },
            shape,
        )

    def relabel(self, reward: RewardFunction) -> None:
        """Replace the reward of every stored step by what a function makes of it.

        The function gets the steps as rollouts of one step each (see `steps`).
        """
        if self._size:  # without any, the widths of the columns are not known
            self._columns["reward"][: self._size] = reward(self.steps()).view(-1)

    def state(self, rows: bool) -> dict[str, Any]:
        """Return everything that later samples depend on.

        Args:
            rows: include the stored steps, as `buffer`; otherwise it is None, and a
                restored buffer is empty.
        """
        stored = {name: c[: self._size] for name, c in self._columns.items()}
        rows = rows and self._size > 0
        return {
            "buffer": stored if rows else None,
            "cursor": self._cursor if rows else 0,
            "current": self._current,
            "episodes": self._episodes,
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Restore what `state` returned.

        Raises:
            ValueError: it is of a buffer of other sizes, or damaged.
        """
        stored = state["buffer"]
        size = 0 if stored is None else len(stored["reward"])
        if stored is not None:
            self._fit_widths({name: stored[name] for name in OPTIONAL})
            check_columns(stored, self._columns, size)
        check_links(state, size, self.capacity)
        for name, column in (stored or {}).items():
            self._columns[name][:size] = column
        self._size, self._cursor = size, state["cursor"]
        self._current = state["current"].clone().to(self._device)
        self._episodes = state["episodes"]

    def _prepare(self, batch: TensorDictBase) -> None:
        """Make room for optional numbers; begin anew with other environments."""
        self._fit_widths({n: numbers_after(batch, key) for n, key in OPTIONAL.items()})
        if len(self._current) != len(batch):
            self._current = torch.full((len(batch),), NONE, device=self._device)

    def _fit_widths(self, numbers: Mapping[str, Tensor]) -> None:
        """Give the optional columns the widths of numbers [..., K], while empty."""
        for name, values in numbers.items():
            width = values.shape[-1]
            if width != self._columns[name].shape[-1] and not self._size:
                shape = self.capacity, width
                self._columns[name] = torch.zeros(shape, device=self._device)

    def _number_episodes(self, ended: Tensor) -> Tensor:
        """Number the episodes of [N, T] steps; `_current` [N] is advanced past them."""
        starts = episode_starts(ended, self._current == NONE).long()
        fresh = self._episodes + starts.flatten().cumsum(0).view(starts.shape) - 1
        numbers = torch.where(starts.cumsum(1) > 0, fresh, self._current[:, None])
        self._current = torch.where(ended[:, -1], NONE, numbers[:, -1])
        self._episodes += int(starts.sum())
        return numbers

    def _write(self, rows: Tensor, batch: TensorDictBase, episode: Tensor) -> None:
        following = batch["next"]
        env = torch.arange(len(batch), dtype=torch.int32, device=self._device)
        values = {
            "before": torch.cat([batch["observation"], batch["action"]], -1),
            "after": following["observation"],
            "reward": following["reward"].squeeze(-1),
            "terminated": following["terminated"].squeeze(-1),
            "ended": following["done"].squeeze(-1),
            "env": env[:, None].expand(batch.shape),
            "episode": episode,
            **{image_before(name): batch[name] for name in self.cameras},
            **{image_after(name): following[name] for name in self.cameras},
        }
        values |= {name: numbers_after(batch, key) for name, key in OPTIONAL.items()}
        for name, value in values.items():
            self._columns[name][rows] = value.flatten(0, 1)

    def _link(self, rows: Tensor, ended: Tensor) -> None:
        """Link the rows [N, T] of a rollout to each other."""
        link = self._columns["link"]
        link[rows[:, :-1]] = torch.where(ended[:, :-1], NONE, rows[:, 1:])
        link[rows[:, -1]] = NONE
