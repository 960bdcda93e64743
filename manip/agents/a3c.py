"""Asynchronous advantage actor-critic (Mnih et al. 2016, arXiv 1602.01783).

Workers, each with its own thread and environments, run at the same time.
Each of them repeats:

    copy the shared parameters:  theta_w <- theta
    collect a rollout, and compute the gradient g_w of A2C's loss at theta_w
    step the shared parameters:  theta <- Adam(theta, g_w)

By default the updates are pipelined, not asynchronous: the shared steps are taken in a
fixed order of the workers, and a worker that is ready early waits for its turn, so that
a run repeats bit for bit. A gradient is `workers` - 1 updates old when it is used.

With `asynchronous`, as in the paper, each gradient is used when it arrives. A slow
worker delays no other, the ages of gradients vary with the speed of the threads, and a
run does not repeat.
"""

from collections import deque
from dataclasses import dataclass
from typing import Annotated, Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase

from manip.agents.a2c import A2C, A2CConfig
from manip.agents.agent import Spaces
from manip.agents.on_policy import RolloutPolicy
from manip.agents.value_targets import add_values
from manip.io.option_ranges import COUNT


@dataclass(frozen=True)
class A3CConfig(A2CConfig):
    """Options of A3C; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    workers: Annotated[int, COUNT] = 4
    """Threads that collect and differentiate; num_envs is split evenly over them."""
    asynchronous: bool = False
    """Use each worker's gradient as soon as it is there, as in the paper. Otherwise in
    turns, which repeats bit for bit."""


class Worker(RolloutPolicy):
    """Act with a copy of the shared networks, which also computes the gradient."""

    def __init__(self, copy: A2C) -> None:
        super().__init__(copy.gaussian)
        self.copy = copy

    def __getstate__(self) -> dict[str, Any]:
        """What acts; only the learner's process has the copy and its gradient."""
        return {name: v for name, v in vars(self).items() if name != "copy"}


class A3C(A2C):
    """A3C; see the module's docstring."""

    name = "a3c"
    Config = A3CConfig

    def __init__(self, config: A3CConfig, spaces: Spaces, threads: int = 1) -> None:
        super().__init__(config, spaces)
        self._copies = deque(A2C(config, spaces) for _ in range(config.workers))
        """Networks that no worker uses at present."""

    def policy(self) -> TensorDictModuleBase:
        """Return a worker, with a copy of the present shared parameters."""
        copy = self._copies.popleft()
        copy.load(self)
        return Worker(copy)

    def process_rollout(
        self, policy: TensorDictModuleBase, batch: TensorDictBase
    ) -> TensorDictBase:
        """Replace a worker's rollout by its gradient [P] and its observations."""
        assert isinstance(policy, Worker)
        copy = policy.copy
        terms = copy.differentiate(add_values(batch, copy.critic))
        gradient = copy.gradient.clone()
        self._copies.append(copy)
        return TensorDict(
            {
                "observation": batch["observation"],
                "gradient": gradient,
                "logged": {name: torch.tensor(term) for name, term in terms.items()},
            }
        )

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Step the shared parameters down a worker's gradient."""
        self.gradient.copy_(batch["gradient"])
        self._step()
        self._finish(batch["observation"])
        return {name: value.item() for name, value in batch["logged"].items()}
