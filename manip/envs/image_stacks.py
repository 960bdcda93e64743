"""ImageStacks: the latest camera images of N environments, stacked."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from manip.cameras import CameraConfig
from manip.envs.option_checks import state_array

Array = np.ndarray

Draw = Callable[[Array], Mapping[str, Array]]
"""env_ids [n] -> part name -> uint8 [n, H, W, 3], images of the present state."""


class ImageStacks:
    """The stacked images of each camera, uint8 [N, H, W, 3 * frames].

    Arrays that were given out are never changed: each call makes new ones.

    Args:
        cameras: which cameras, and how many latest images of each.
        num_envs: N.
        draw: draws some environments.
    """

    def __init__(self, cameras: CameraConfig, num_envs: int, draw: Draw) -> None:
        self._frames, self._num_envs, self._draw = cameras.frames, num_envs, draw
        self._stacks = {
            part.name: np.zeros((num_envs, *part.shape), np.uint8)
            for part in cameras.parts
        }

    @property
    def now(self) -> dict[str, Array]:
        """Part name -> stacked images of all environments."""
        return dict(self._stacks)

    def append(self) -> None:
        """Draw all environments; each image replaces the oldest of its stack."""
        if self._stacks:
            drawn = self._draw(np.arange(self._num_envs))
            self._stacks = {
                name: np.concatenate([stack[..., 3:], drawn[name]], axis=-1)
                for name, stack in self._stacks.items()
            }

    def restart(self, env_ids: Array) -> None:
        """Fill the stacks of some environments with images of their present state."""
        if self._stacks:
            drawn = self._draw(env_ids)
            stacks = {name: stack.copy() for name, stack in self._stacks.items()}
            for name, stack in stacks.items():
                stack[env_ids] = np.tile(drawn[name], self._frames)
            self._stacks = stacks

    def save_state(self) -> dict[str, Any]:
        """A copy of all stacks, under one name; empty without cameras."""
        stacks = {name: stack.copy() for name, stack in self._stacks.items()}
        return {"images": stacks} if stacks else {}

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Restore what `save_state` returned.

        Raises:
            UserError: it is of other cameras or environments.
        """
        self._stacks = {
            name: state_array(state.get("images", {}), name, stack).copy()
            for name, stack in self._stacks.items()
        }
