"""A second torch device, whose memory is the host's: it shows what stays on the CPU.

Every operation on its tensors runs on the CPU; one that mixes them with tensors of the
CPU raises an error, as on a GPU. `torch.utils.backend_registration` of torch 2.13.
"""

from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor
from torch.utils._pytree import tree_map
from torch.utils.backend_registration import _setup_privateuseone_for_python_backend

NAME = "second"
CPU = torch.device("cpu")

WHOLE = ("abs", "arange", "arange.start", "arange.start_step", "logsumexp")
"""Operations that torch would compose of others that resize their result."""

_memory: dict[int, Tensor] = {}
"""Storage of a tensor of the device -> the tensor of the CPU that holds its numbers."""


_MODULE = SimpleNamespace(
    is_initialized=lambda: True,
    is_available=lambda: True,
    _is_in_bad_fork=lambda: False,
    current_device=lambda: 0,
    device_count=lambda: 1,
    manual_seed_all=lambda seed: None,
    synchronize=lambda: None,
)
"""The functions that torch calls in the module `torch.second`."""


class _Hooks(torch._C._acc.PrivateUse1Hooks):
    def is_available(self) -> bool:
        return True

    is_built = is_available

    def has_primary_context(self, device: int) -> bool:
        return True


def _on_device(numbers: Tensor) -> Tensor:
    shape = tuple(numbers.shape)
    tensor = torch._C._acc.create_empty_tensor(shape, numbers.dtype)
    _memory[tensor.untyped_storage()._cdata] = numbers
    return tensor


def _numbers(tensor: Tensor) -> Tensor:
    """The numbers of a tensor of the device, which may be a view of another's."""
    whole = _memory[tensor.untyped_storage()._cdata]
    if whole.shape == tensor.shape and tensor.is_contiguous():
        return whole
    form = tensor.shape, tensor.stride(), tensor.storage_offset()
    return _strided(whole, *form)


def _strided(whole: Tensor, size: Any, stride: Any, offset: int) -> Tensor:
    """A view of contiguous numbers; a copy of others."""
    if whole.is_contiguous():
        return whole.as_strided(size, stride, whole.storage_offset() + offset)
    flat = whole.reshape(-1)
    return flat[torch.arange(len(flat)).as_strided(size, stride, offset)]


def _run(op: Any, *args: Any, **kwargs: Any) -> Any:
    """Run an operation on the numbers of its arguments."""
    name, owners = op._schema.name, {}
    if name == "aten::as_strided":
        return _as_strided(*args)

    def plain(value: Any) -> Any:
        if isinstance(value, torch.device):
            return CPU
        if not isinstance(value, Tensor):
            return value
        if value.device.type == NAME:
            numbers = _numbers(value)
            owners[id(numbers)] = value
            return numbers
        if value.dim() and name != "aten::_copy_from":
            raise RuntimeError(f"{name}: a tensor {[*value.shape]} is on the CPU")
        return value

    def back(value: Any) -> Any:
        if not isinstance(value, Tensor):
            return value
        return owners[id(value)] if id(value) in owners else _on_device(value)

    numbers, options = tree_map(plain, (args, kwargs))
    if name == "aten::_copy_from":
        numbers[1].copy_(numbers[0])
        return args[1]
    op = torch.ops.aten.reshape if name == "aten::view" else op
    result = op(*_with_tensors(op, numbers), **options)
    return result if _goes_to_cpu(kwargs) else tree_map(back, result)


def _as_strided(tensor: Tensor, size: Any, stride: Any, offset: Any = None) -> Tensor:
    whole = _memory[tensor.untyped_storage()._cdata]
    at = tensor.storage_offset() if offset is None else offset
    return _on_device(_strided(whole, size, stride, at))


def _with_tensors(op: Any, values: tuple[Any, ...]) -> list[Any]:
    """Numbers where the operation takes tensors, as tensors."""
    forms = getattr(op, "_schema", None)
    kinds = [str(a.type) for a in forms.arguments] if forms else [""] * len(values)
    return [
        torch.tensor(value, dtype=torch.float64 if type(value) is float else None)
        if kind == "Tensor" and isinstance(value, bool | int | float)
        else value
        for value, kind in zip(values, kinds, strict=False)
    ]


def _goes_to_cpu(options: dict[str, Any]) -> bool:
    target = options.get("device")
    return target is not None and torch.device(target).type != NAME


def _copied(self: Tensor, memo: dict[int, Any]) -> Tensor:
    if self.device.type != NAME:
        return _deepcopy(self, memo)
    copy: Tensor = memo.setdefault(id(self), self.detach().clone())
    return copy


_setup_privateuseone_for_python_backend(NAME, backend_module=_MODULE, hook=_Hooks())
_fallback, _aten = (torch.library.Library(name, "IMPL") for name in ("_", "aten"))
_fallback.fallback(_run, "PrivateUse1")
for _name in WHOLE:
    _base, _, _overload = _name.partition(".")
    _op = getattr(getattr(torch.ops.aten, _base), _overload or "default")
    _aten.impl(_name, lambda *a, op=_op, **k: _run(op, *a, **k), "PrivateUse1")
_deepcopy, torch.Tensor.__deepcopy__ = torch.Tensor.__deepcopy__, _copied

SECOND = torch.device(NAME, 0)


def seeded_generator(device: Any = "cpu") -> torch.Generator:
    """As in manip.agents.networks: the device draws with generators of the CPU."""
    return torch.Generator().manual_seed(int(torch.randint(2**62, ())))
