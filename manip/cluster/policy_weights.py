"""Split a policy into its weights, which many collectors share, and the rest."""

import pickle
from collections.abc import Callable
from io import BytesIO
from threading import Lock
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

Weights = dict[str, Tensor]
"""Name of a parameter or buffer of a policy -> its value."""


class SharedWeights:
    """Stores weights once for all policies that have the same.

    Args:
        put: stores weights and returns a reference to them, such as `ray.put`.
    """

    def __init__(self, put: Callable[[Weights], Any]) -> None:
        self._put, self._lock = put, Lock()
        self._latest: Weights = {}
        self._reference: Any = None

    def split(self, policy: TensorDictModuleBase) -> tuple[Any, bytes]:
        """A reference to the policy's weights, and all else of it, for `whole`."""
        weights, rest = split(policy)
        with self._lock:
            if not _equal(weights, self._latest):
                self._latest, self._reference = weights, self._put(weights)
            return self._reference, rest


def split(policy: TensorDictModuleBase) -> tuple[Weights, bytes]:
    """The weights of a policy, and all else of it, pickled."""
    weights = dict(policy.named_parameters()) | dict(policy.named_buffers())
    file = BytesIO()
    _Pickler(file, weights).dump(policy)
    return weights, file.getvalue()


def whole(weights: Weights, rest: bytes) -> TensorDictModuleBase:
    """The policy of what `split` returned."""
    policy: TensorDictModuleBase = _Unpickler(BytesIO(rest), weights).load()
    return policy


class _Pickler(pickle.Pickler):
    """Writes names in place of weights."""

    def __init__(self, file: BytesIO, weights: Weights) -> None:
        super().__init__(file)
        self._names = {id(weight): name for name, weight in weights.items()}

    def persistent_id(self, value: Any) -> str | None:
        return self._names.get(id(value))


class _Unpickler(pickle.Unpickler):
    """Reads weights in place of names."""

    def __init__(self, file: BytesIO, weights: Weights) -> None:
        super().__init__(file)
        self._weights = weights

    def persistent_load(self, name: str) -> Tensor:
        return self._weights[name]


def _equal(weights: Weights, others: Weights) -> bool:
    return weights.keys() == others.keys() and all(
        torch.equal(weight, others[name]) for name, weight in weights.items()
    )
