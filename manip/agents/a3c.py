"""Asynchronous advantage actor-critic (Mnih et al. 2016, arXiv 1602.01783).

Workers, each on a thread of its own and with worlds of its own, take turns without
waiting for each other:

    copy the shared parameters:  theta_w <- theta
    collect a rollout, and find the gradient g_w of A2C's loss in theta_w
    step the shared parameters:  theta <- Adam(theta, g_w)

While one works, the others move theta on: a gradient is `workers` - 1 steps old when it
is taken. The shared steps are taken in a fixed order of the workers, so that a run
repeats itself bit for bit; the paper takes them as they come.
"""

from dataclasses import dataclass
from itertools import cycle

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase

from manip.agents.a2c import A2C, A2CConfig
from manip.agents.agent import Spaces
from manip.agents.on_policy import RolloutPolicy
from manip.agents.value_targets import add_values


@dataclass(frozen=True)
class A3CConfig(A2CConfig):
    """Options of A3C; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    workers: int = 4
    """Threads that collect and differentiate; they share the worlds evenly."""


class Worker(RolloutPolicy):
    """Acts by a copy of the shared networks, and finds gradients in them."""

    def __init__(self, copy: A2C) -> None:
        super().__init__(copy.actor)
        self.copy = copy


class A3C(A2C):
    """A3C on TorchRL; see the module's docstring."""

    def __init__(self, config: A3CConfig, spaces: Spaces, threads: int = 1) -> None:
        super().__init__(config, spaces)
        self.workers = config.workers
        self._copies = cycle([A2C(config, spaces) for _ in range(config.workers)])

    def policy(self) -> TensorDictModuleBase:
        """The next worker, with the shared parameters of now."""
        copy = next(self._copies)
        copy.load(self)
        return Worker(copy)

    def process_rollout(
        self, policy: TensorDictModuleBase, batch: TensorDictBase
    ) -> TensorDictBase:
        """The gradient [P] of a worker's rollout, and what it has seen."""
        assert isinstance(policy, Worker)
        copy = policy.copy
        told = copy.differentiate(add_values(batch, copy.critic))
        found = {name: torch.tensor(value) for name, value in told.items()}
        return TensorDict(
            {
                "observation": batch["observation"],
                "gradient": copy.gradient.clone(),
                "told": found,
            }
        )

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """A step of the shared parameters down a worker's gradient."""
        self.gradient.copy_(batch["gradient"])
        self._step()
        self._see(batch["observation"])
        return {name: value.item() for name, value in batch["told"].items()}
