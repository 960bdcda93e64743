"""Exploration of off-policy algorithms: a copy of the actor, with noise."""

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Generator, Tensor

from manip.agents.actor_inputs import ActorInputs
from manip.agents.image_actor import ImageActor
from manip.agents.networks import Actor, BinnedActor, seeded_generator

Explore = Callable[[Any, tuple[Tensor, ...], Generator], Tensor]
"""(actor, its inputs [N, ...], random generator) -> action [N, A] / action_scale."""

BURST = 0.9
"""Gripper command of a burst: inside the range, where tanh has an inverse."""


class RolloutPolicy(TensorDictModuleBase):
    """Explore with a copy of the actor.

    A gripper takes ten steps from closed to open, so noise of single steps never opens
    a gripper that the actor never opens. In a burst the gripper opens, or closes, for
    a whole rollout.

    Args:
        inputs: what the actor sees of a state.
        explore: draws an action; see `Explore`.
        warm_up: draw uniform actions instead.
        bursts: fraction of the environments whose gripper has a burst.
    """

    out_keys = ["action"]

    def __init__(
        self,
        actor: Actor | BinnedActor | ImageActor,
        inputs: ActorInputs,
        explore: Explore,
        warm_up: bool = False,
        bursts: float = 0.0,
    ) -> None:
        super().__init__()
        self.in_keys, self._inputs = [*inputs.keys], inputs
        self._actor, self._warm_up, self._bursts = deepcopy(actor), warm_up, bursts
        self._explore, self._device = explore, actor.action_scale.device
        self._generator = seeded_generator(self._device)
        self._gripper: Tensor | None = None

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A]."""
        inputs = self._inputs.of(tensordict)
        unit = self._draw(tuple(part.to(self._device) for part in inputs))
        if self._gripper is None:
            self._gripper = self._draw_bursts(len(unit))
        unit[:, -1] = self._gripper.where(self._gripper != 0, unit[:, -1])
        action = self._actor.action_scale * unit
        return tensordict.set("action", action.to(inputs[0].device))

    def _draw(self, inputs: tuple[Tensor, ...]) -> Tensor:
        if self._warm_up:
            shape = (len(inputs[0]), len(self._actor.action_scale))
            return self._uniform(shape) * 2 - 1
        return self._explore(self._actor, inputs, self._generator)

    def _draw_bursts(self, num_envs: int) -> Tensor:
        """Draw the gripper's commands [N] for the rollout; 0 leaves it to the actor."""
        unit = self._uniform((num_envs,))
        command = torch.where(unit < self._bursts / 2, BURST, -BURST)
        return command * (unit < self._bursts)

    def _uniform(self, shape: tuple[int, ...]) -> Tensor:
        return torch.rand(shape, generator=self._generator, device=self._device)
