"""Evaluate a policy in blocks of rows of one size.

Matrix products round differently for other numbers of rows. In blocks of one size, an
episode does not depend on how many run side by side, to the last bit.
"""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

Policy = Callable[[Mapping[str, Tensor]], Tensor]

ROWS = 16


def in_blocks(policy: Policy) -> Policy:
    """The same policy, evaluated in blocks of `ROWS` rows; the last is filled up."""

    def act(parts: Mapping[str, Tensor]) -> Tensor:
        num_envs = len(next(iter(parts.values())))
        actions = [
            policy({name: _block(part, start) for name, part in parts.items()})
            for start in range(0, num_envs, ROWS)
        ]
        return torch.cat(actions)[:num_envs]

    return act


def _block(part: Tensor, start: int) -> Tensor:
    rows = part[start : start + ROWS]
    missing = ROWS - len(rows)
    return torch.cat([rows, rows[-1:].expand(missing, *rows.shape[1:])])
