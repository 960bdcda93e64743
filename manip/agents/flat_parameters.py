"""Many parameters as views of one flat tensor, for optimisers and native code."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn


def flatten(parts: Sequence[Tensor], leading: int = 0) -> nn.Parameter:
    """Join tensors to one parameter; they and their gradients become its views.

    Args:
        parts: [*batch, ...] each, with `leading` batch dimensions in common.

    Returns:
        [*batch, P], the parts one after the other, with its gradient allocated.
    """
    flat = nn.Parameter(torch.cat([p.detach().flatten(leading) for p in parts], -1))
    flat.grad = torch.zeros_like(flat)
    at = 0
    for part in parts:
        width = part[(0,) * leading].numel()
        part.data = flat.data[..., at : at + width].view(part.shape)
        if part.requires_grad:
            part.grad = flat.grad[..., at : at + width].view(part.shape)
        at += width
    return flat


def zero_gradient(param: nn.Parameter) -> None:
    """Set a flat gradient to zero in place, as others are views of it."""
    assert param.grad is not None
    param.grad.zero_()
