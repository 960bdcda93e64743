"""The policy of behaviour cloning's rollouts: a disturbed expert, and its clone."""

from copy import deepcopy

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from manip.agents.actor_inputs import ActorInputs
from manip.agents.image_actor import ImageActor
from manip.agents.networks import Actor, seeded_generator


class LastingNoise:
    """Add noise to actions that grows over the environments and lasts several steps.

    Args:
        noise: standard deviation in the last environment; it is 0 in the first.
        noise_steps: mean number of control steps for which a sample is used.
    """

    def __init__(self, noise: float, noise_steps: int) -> None:
        self._noise, self._renewal = noise, 1 / noise_steps
        self._generator = seeded_generator()
        self._offset: Tensor | None = None

    def __call__(self, action: Tensor) -> Tensor:
        """The disturbed actions [N, A], which may leave [-1, 1]."""
        level = torch.linspace(0, self._noise, len(action))[:, None]
        return action + level * self._offsets(action.shape)

    def _offsets(self, shape: torch.Size) -> Tensor:
        """Draw standard normal noise [N, A]; rows are redrawn at random times."""
        offset = torch.randn(shape, generator=self._generator)
        if self._offset is not None:
            chance = torch.rand((len(offset), 1), generator=self._generator)
            offset = torch.where(chance < self._renewal, offset, self._offset)
        self._offset = offset
        return offset


class Demonstration(TensorDictModuleBase):
    """Act as the expert, with noise that lasts several steps; or as its clone.

    Args:
        inputs: what the clone sees.
        clones: fraction of the environments, the last ones, in which the clone acts.
    """

    out_keys = ["action"]

    def __init__(
        self,
        actor: Actor | ImageActor,
        inputs: ActorInputs,
        noise: float,
        noise_steps: int,
        clones: float,
    ) -> None:
        super().__init__()
        self.in_keys = [*inputs.keys, "expert_action"]
        self._actor, self._inputs, self._clones = deepcopy(actor), inputs, clones
        self._disturbed = LastingNoise(noise, noise_steps)

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A]."""
        expert = tensordict["expert_action"]
        first = len(expert) - round(self._clones * len(expert))
        clone = self._actor.decide(*self._inputs.of(tensordict[first:]))
        action = torch.cat([self._disturbed(expert[:first]), clone])
        return tensordict.set("action", action.clamp(-1, 1))
