"""A convolutional encoder of camera images, and their augmentation.

Images are uint8 [..., H, W, C], as cameras give them.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor, nn

from manip.agents.networks import check_widths
from manip.errors import UserError, shown

MOST_CHANNELS = 1024
"""Most channels of a convolution."""


class EncoderSizes(NamedTuple):
    """Sizes of the encoders of an actor, one for each camera.

    Attributes:
        images: shape (H, W, C) of each camera's image.
        channels: of the convolutions.
        features: F, outputs of each encoder.
    """

    images: tuple[tuple[int, ...], ...]
    channels: tuple[int, ...]
    features: int


class ImageEncoder(nn.Module):
    """Encode an image: uint8 [..., H, W, C] -> features [..., F] of at least 0.

    Convolutions of stride 2 with ReLU (5x5, then 3x3), a linear layer, LayerNorm, ReLU.

    Raises:
        UserError: no convolution, too many, or a layer without channels or too large.
    """

    def __init__(
        self, shape: Sequence[int], channels: Sequence[int], features: int
    ) -> None:
        super().__init__()
        height, width, inputs = shape
        check_widths(inputs, features, channels)
        if not channels or max(channels) > MOST_CHANNELS:
            raise UserError(
                f"image_channels must be one number or more, of at most "
                f"{MOST_CHANNELS}, not {shown(list(channels))}"
            )
        layers: list[nn.Module] = []
        for outputs in channels:
            kernel = 3 if layers else 5
            layers += [nn.Conv2d(inputs, outputs, kernel, 2, kernel // 2), nn.ReLU()]
            inputs, height, width = outputs, -(-height // 2), -(-width // 2)
        self.convolutions = nn.Sequential(*layers)
        self.output = nn.Sequential(
            nn.Linear(inputs * height * width, features),
            nn.LayerNorm(features),
            nn.ReLU(),
        )

    def forward(self, image: Tensor) -> Tensor:
        """Return the features [..., F]."""
        lead = image.shape[:-3]
        pixels = image.reshape(-1, *image.shape[-3:]).permute(0, 3, 1, 2)
        maps = self.convolutions(pixels / 255.0 - 0.5)
        return self.output(maps.flatten(1)).unflatten(0, lead)


def random_shift(image: Tensor, most: int) -> Tensor:
    """Shift each image [B, H, W, C] by up to `most` pixels along both axes.

    Shifts are uniform whole numbers; the image's edge is repeated. This is the random
    shift of DrQ (Kostrikov et al. 2020, arXiv 2004.13649).
    """
    if not most:
        return image
    count, height, width = image.shape[:3]
    drawn = torch.randint(-most, most + 1, (2, count, 1))
    rows = (torch.arange(height) + drawn[0]).clamp(0, height - 1)
    columns = (torch.arange(width) + drawn[1]).clamp(0, width - 1)
    batch = torch.arange(count)[:, None, None]
    return image[batch, rows[:, :, None], columns[:, None, :]]


@contextmanager
def fast_precision() -> Iterator[None]:
    """Compute networks in bfloat16 inside, where the processor does so in hardware.

    Updates from images of 64 pixels then take about half the time (see
    docs/cameras.md). Weights and optimisers remain float32.
    """
    abilities = torch.cpu.get_capabilities()
    native = abilities.get("avx512_bf16") or abilities.get("amx_bf16")
    with torch.autocast("cpu", torch.bfloat16, enabled=bool(native)):
        yield
