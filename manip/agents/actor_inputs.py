"""The part of an observation that an actor sees; critics may see all of it."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from manip.observation import ObservationPart, ObservationSpec


@dataclass(frozen=True)
class ActorInputs:
    """Inputs of an actor: entries of the joined observation [D], and camera images.

    Attributes:
        columns: indices of the entries; None for all of them.
        cameras: the camera parts: uint8 images [H, W, C].
    """

    columns: tuple[int, ...] | None = None
    cameras: tuple[ObservationPart, ...] = ()

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of a rollout that `of` reads."""
        return ("observation", *(camera.name for camera in self.cameras))

    def of(self, state: Mapping[str, Any] | Any) -> tuple[Tensor, ...]:
        """Select the inputs from a state or rollout [...] (a TensorDict).

        Returns:
            The vector [..., V] float32, then the image [..., H, W, C] uint8 of each
            camera: the arguments of an actor.
        """
        observation, *images = (state[key] for key in self.keys)
        return self.vector(observation), *images

    def vector(self, observation: Tensor) -> Tensor:
        """Select the entries [..., V] from joined observations [..., D]."""
        if self.columns is None:
            return observation
        return observation[..., list(self.columns)]


def camera_inputs(spec: ObservationSpec, names: Collection[str] = ()) -> ActorInputs:
    """Inputs that a real arm has: its cameras and the parts of role proprioception.

    Args:
        spec: the whole observation.
        names: parts of the joined observation to see instead of the proprioception.

    Raises:
        UserError: there is no such part.
    """
    vector = spec.select(spec.slices)
    chosen = vector.select(names).names or [
        part.name for part in vector.parts if part.role == "proprioception"
    ]
    columns = [
        index
        for name, place in spec.slices.items()
        if name in chosen
        for index in range(place.start, place.stop)
    ]
    cameras = tuple(part for part in spec.parts if part.role == "camera")
    return ActorInputs(tuple(columns), cameras)


def seen_parts(spec: ObservationSpec, inputs: ActorInputs) -> ObservationSpec:
    """The parts of an observation of which an actor sees at least one entry."""
    cameras = {camera.name for camera in inputs.cameras}
    columns = range(spec.dim) if inputs.columns is None else inputs.columns

    def is_seen(part: ObservationPart) -> bool:
        place = spec.slices.get(part.name)
        return part.name in cameras if place is None else place.start in columns

    return ObservationSpec(tuple(part for part in spec.parts if is_seen(part)))
