"""Gradients and losses that are not finite: one update is lost, or the run ends."""

from collections import deque
from collections.abc import Mapping
from functools import partial
from math import isfinite
from typing import Any

from torch.nn.utils import get_total_norm
from torch.optim import Optimizer

from manip.errors import UserError


class NanGuard:
    """Looks at every gradient before an optimiser takes it, whatever the algorithm.

    A gradient that is not finite becomes zero: the parameters keep what they have
    learned.

    Args:
        optimisers: name -> optimiser.
        stop: whether that is an error.

    Attributes:
        lost: what was not finite lately; whoever tells of it removes it.
        count: how often something was not finite so far.
    """

    def __init__(self, optimisers: Mapping[str, Optimizer], stop: bool) -> None:
        self.lost: deque[str] = deque(maxlen=1000)
        self.count = 0
        self._stop = stop
        for name, optimiser in optimisers.items():
            optimiser.register_step_pre_hook(partial(self._look, name))

    def _look(self, name: str, optimiser: Optimizer, *_: Any) -> None:
        gradients = [
            parameter.grad
            for group in optimiser.param_groups
            for parameter in group["params"]
            if parameter.grad is not None
        ]
        if get_total_norm(gradients).isfinite():
            return
        self._note(f"the gradient of the optimiser {name!r}")
        for gradient in gradients:
            gradient.zero_()

    def finite(self, learned: Mapping[str, float]) -> dict[str, float]:
        """What was learned, less what is not finite."""
        kept = {name: value for name, value in learned.items() if isfinite(value)}
        if kept.keys() != learned.keys():
            self._note(", ".join(sorted(learned.keys() - kept.keys())))
        return kept

    def _note(self, what: str) -> None:
        if self._stop:
            raise UserError(f"{what} is not finite")
        self.count += 1
        self.lost.append(f"{what} is not finite")
