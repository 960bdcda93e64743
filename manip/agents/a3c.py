"""Asynchronous advantage actor-critic (Mnih et al. 2016, arXiv 1602.01783).

Workers, each with its own thread and environments, run at the same time.
Each of them repeats:

    copy the shared parameters:  theta_w <- theta
    collect a rollout, and compute the gradient g_w of A2C's loss at theta_w
    step the shared parameters:  theta <- Adam(theta, g_w)

The updates are pipelined, not asynchronous: the shared steps are taken in a fixed order
of the workers, and a worker that is ready early waits for its turn, so that a run
repeats bit for bit. The paper takes each gradient when it arrives. As in the paper, a
gradient is stale: it is `workers` - 1 updates old when it is used.
"""

from dataclasses import dataclass
from itertools import cycle
from typing import Annotated

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


class Worker(RolloutPolicy):
    """Act with a copy of the shared networks, which also computes the gradient."""

    def __init__(self, copy: A2C) -> None:
        super().__init__(copy.gaussian)
        self.copy = copy


class A3C(A2C):
    """A3C; see the module's docstring."""

    name = "a3c"
    Config = A3CConfig

    def __init__(self, config: A3CConfig, spaces: Spaces, threads: int = 1) -> None:
        super().__init__(config, spaces)
        self._copies = cycle([A2C(config, spaces) for _ in range(config.workers)])

    def policy(self) -> TensorDictModuleBase:
        """Return the next worker, with a copy of the present shared parameters."""
        copy = next(self._copies)
        copy.load(self)
        return Worker(copy)

    def process_rollout(
        self, policy: TensorDictModuleBase, batch: TensorDictBase
    ) -> TensorDictBase:
        """Replace a worker's rollout by its gradient [P] and its observations."""
        assert isinstance(policy, Worker)
        copy = policy.copy
        terms = copy.differentiate(add_values(batch, copy.critic))
        return TensorDict(
            {
                "observation": batch["observation"],
                "gradient": copy.gradient.clone(),
                "logged": {name: torch.tensor(term) for name, term in terms.items()},
            }
        )

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Step the shared parameters down a worker's gradient."""
        self.gradient.copy_(batch["gradient"])
        self._step()
        self._finish(batch["observation"])
        return {name: value.item() for name, value in batch["logged"].items()}
