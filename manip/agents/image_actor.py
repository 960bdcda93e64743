"""An actor that sees camera images and a vector."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from manip.agents.image_encoder import EncoderSizes, ImageEncoder
from manip.agents.networks import Actor, RunningNorm


class ImageActor(nn.Module):
    """Gaussian actor: vector [..., V] and images [..., H, W, C] -> (loc, scale).

    Each camera has an encoder. Its features are joined with the vector and passed to a
    `head`, an `Actor`.

    Args:
        sizes: of the encoders, and of the images.
        vector_dim: V.
        action_dim: A.
        hidden: widths of the head's hidden layers.
        squash: see `Actor`.
        normalise: put a RunningNorm before the vector.
        action_scale: see `Actor`.
    """

    bins = 0

    def __init__(
        self,
        sizes: EncoderSizes,
        vector_dim: int,
        action_dim: int,
        hidden: Sequence[int],
        squash: bool,
        normalise: bool,
        action_scale: Sequence[float] = (),
    ) -> None:
        super().__init__()
        self.sizes, self.squash = sizes, squash
        self.encoders = nn.ModuleList(
            ImageEncoder(shape, sizes.channels, sizes.features)
            for shape in sizes.images
        )
        self.norm = RunningNorm(vector_dim) if normalise else nn.Identity()
        joined = vector_dim + sizes.features * len(sizes.images)
        self.head = Actor(joined, action_dim, hidden, squash, False, action_scale)

    @property
    def body(self) -> nn.Sequential:
        """The head's layers."""
        return self.head.body

    @property
    def action_scale(self) -> Tensor:
        """[A], fraction of each dimension's range that is used."""
        return self.head.action_scale

    def features(self, vector: Tensor, *images: Tensor) -> Tensor:
        """Join the vector with the features of all images: [..., V + cameras * F]."""
        pairs = zip(self.encoders, images, strict=True)
        encoded = [encoder(image) for encoder, image in pairs]
        return torch.cat([self.norm(vector), *encoded], -1)

    def forward(self, vector: Tensor, *images: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation [..., A], as `Actor` does."""
        loc, scale = self.head(self.features(vector, *images))
        return loc, scale

    def decide(self, vector: Tensor, *images: Tensor) -> Tensor:
        """Return the deterministic action [..., A] in [-1, 1]."""
        return self.head.decide(self.features(vector, *images))

    def set_deviation(self, deviation: float) -> None:
        """Set the standard deviation, for every state; see `Actor.set_deviation`."""
        self.head.set_deviation(deviation)

    def squashed(self, raw: Tensor) -> Tensor:
        """Map a Gaussian sample [..., A] to an action: action_scale tanh(raw)."""
        return self.head.squashed(raw)
