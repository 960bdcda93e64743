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
    """Check every gradient before an optimiser uses it, for every algorithm.

    A gradient that is not finite becomes zero, which leaves the parameters finite.

    Args:
        optimisers: name -> optimiser.
        stop: raise an error instead.

    Attributes:
        messages: what was not finite; the reader removes what it has reported.
        count: how often something was not finite so far.
    """

    def __init__(self, optimisers: Mapping[str, Optimizer], stop: bool) -> None:
        self.messages: deque[str] = deque(maxlen=1000)
        self.count = 0
        self._stop = stop
        for name, optimiser in optimisers.items():
            optimiser.register_step_pre_hook(partial(self._check, name))

    def _check(self, name: str, optimiser: Optimizer, *_: Any) -> None:
        gradients = [
            parameter.grad
            for group in optimiser.param_groups
            for parameter in group["params"]
            if parameter.grad is not None
        ]
        if get_total_norm(gradients).isfinite():
            return
        self._report(f"the gradient of the optimiser {name!r}")
        for gradient in gradients:
            gradient.zero_()

    def finite(self, values: Mapping[str, float]) -> dict[str, float]:
        """Drop the values of an update that are not finite.

        Raises:
            UserError: one is not finite, and that is to stop the run.
        """
        finite = {name: value for name, value in values.items() if isfinite(value)}
        if len(finite) < len(values):
            self._report(", ".join(sorted(values.keys() - finite.keys())))
        return finite

    def _report(self, name: str) -> None:
        if self._stop:
            raise UserError(f"{name} is not finite")
        self.count += 1
        self.messages.append(f"{name} is not finite")
