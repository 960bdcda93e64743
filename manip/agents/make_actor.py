"""Options of actors that see images, and the choice of an actor for its inputs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from manip.agents.agent import AgentConfig, Spaces
from manip.agents.image_actor import ImageActor
from manip.agents.image_encoder import EncoderSizes
from manip.agents.networks import Actor
from manip.io.option_ranges import COUNT, Range


@dataclass(frozen=True)
class ImageConfig(AgentConfig):
    """Options of actors that see camera images; others ignore them."""

    image_channels: Annotated[tuple[int, ...], COUNT] = (16, 32, 32)
    """Channels of the encoder's convolutions (5x5, then 3x3), each of which halves the
    image's height and width. More channels see more, and cost more time."""
    image_features: Annotated[int, COUNT] = 128
    """Numbers to which the encoder reduces each camera's image."""
    image_shift: Annotated[int, Range(0, 64)] = 0
    """Largest random shift of the images during updates [pixel] (random crop of a
    padded image, data augmentation); 0 for none."""


def make_actor(
    spaces: Spaces,
    options: ImageConfig,
    hidden: Sequence[int],
    *,
    squash: bool,
    normalise: bool,
    action_scale: Sequence[float] = (),
) -> Actor | ImageActor:
    """Build an actor for its inputs: with an encoder for each camera, if any."""
    inputs = spaces.inputs
    form = spaces.action_dim, hidden, squash, normalise, action_scale
    if not inputs.cameras:
        return Actor(spaces.vector_dim, *form)
    sizes = EncoderSizes(
        tuple(camera.shape for camera in inputs.cameras),
        options.image_channels,
        options.image_features,
    )
    return ImageActor(sizes, spaces.vector_dim, *form)
