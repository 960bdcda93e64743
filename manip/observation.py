"""The observation contract: named parts, and the vector that joins them.

A policy card stores the same specification as plain values, so that a policy names the
parts that it needs instead of relying on places in a vector.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from manip.arrays import is_tensor, namespace
from manip.errors import UserError, shown, unknown

Array = np.ndarray
Vector = TypeVar("Vector")
"""A numpy array or a torch tensor."""

ROLES = ("proprioception", "object", "camera")
"""Source of a part on a real robot: its joint sensors, an estimator of objects' poses,
or a camera."""


class ObservationPart(NamedTuple):
    """One named part of an observation.

    Attributes:
        name: unique within the observation.
        shape: of one environment, without the batch dimension.
        dtype: numpy's name of the numbers, e.g. "float32".
        role: one of `ROLES`.
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    role: str


@dataclass(frozen=True)
class ObservationSpec:
    """The ordered parts of an observation.

    Parts that are no cameras are joined into one float32 vector [D], in order.
    """

    parts: tuple[ObservationPart, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parts, in order."""
        return tuple(part.name for part in self.parts)

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Part name -> its columns in the joined vector."""
        slices, start = {}, 0
        for part in self.parts:
            if part.role != "camera":
                slices[part.name] = slice(start, start + prod(part.shape))
                start += prod(part.shape)
        return slices

    @property
    def dim(self) -> int:
        """D, the length of the joined vector."""
        return max((columns.stop for columns in self.slices.values()), default=0)

    def join(self, parts: Mapping[str, Array]) -> Array:
        """Concatenate named parts [N, ...] into [N, D] float32, in this order.

        Numbers beyond float32's range become infinite, without a warning.
        """
        named = [parts[name] for name in self.slices]
        if named and is_tensor(named[0]):
            return _joined_tensors(named)
        flat = [np.reshape(part, (len(part), -1)) for part in named]
        with np.errstate(over="ignore"):
            return np.concatenate(flat, axis=1, dtype=np.float32)

    def split(self, vector: Vector) -> dict[str, Vector]:
        """Named views `[..., *shape]` of a joined vector [..., D] (numpy or torch)."""
        joined = cast(Any, vector)
        return {
            part.name: joined[..., self.slices[part.name]].reshape(
                (*joined.shape[:-1], *part.shape)
            )
            for part in self.parts
            if part.name in self.slices
        }

    def select(self, names: Iterable[str]) -> "ObservationSpec":
        """The specification of some of the parts, in the order of `names`.

        Raises:
            UserError: there is no such part.
        """
        by_name = {part.name: part for part in self.parts}
        for name in names:
            if name not in by_name:
                raise unknown("observation part", name, by_name)
        return ObservationSpec(tuple(by_name[name] for name in names))

    def to_dict(self) -> list[dict[str, Any]]:
        """One dict of plain values per part, fit for JSON; see `from_dict`."""
        return [part._asdict() | {"shape": list(part.shape)} for part in self.parts]

    @classmethod
    def from_dict(cls, parts: Any) -> "ObservationSpec":
        """The specification that `to_dict` wrote.

        Raises:
            UserError: a part is incomplete, or has an impossible shape, dtype or role.
        """
        if not isinstance(parts, Sequence) or isinstance(parts, str):
            raise UserError(f"an observation is a list of parts, not {shown(parts)}")
        spec = cls(tuple(_part(part) for part in parts))
        if len(set(spec.names)) < len(spec.names):
            raise UserError("two parts of the observation have the same name")
        return spec


def _joined_tensors(parts: Sequence[Any]) -> Any:
    flat = [part.reshape((len(part), -1)) for part in parts]
    return namespace(flat[0]).concatenate(flat, axis=1).float()


def vector_spec(
    parts: Mapping[str, Array], proprioception: Iterable[str]
) -> ObservationSpec:
    """The specification of parts [N, ...], of which some are proprioception."""

    def role(name: str) -> str:
        return "proprioception" if name in proprioception else "object"

    return ObservationSpec(
        tuple(
            ObservationPart(name, tuple(part.shape[1:]), "float32", role(name))
            for name, part in parts.items()
        )
    )


def check_observation(
    parts: Sequence[Mapping[str, Any]], spec: ObservationSpec
) -> None:
    """Compare the parts that a policy needs with those that an environment gives.

    Args:
        parts: the policy's parts, as `ObservationSpec.to_dict` gives them.
        spec: the environment's observation; it may have more parts, in any order.

    Raises:
        UserError: a part is missing or has another shape or dtype; all are named.
    """
    given = {part.name: part for part in spec.parts}
    different = []
    for part in ObservationSpec.from_dict(parts).parts:
        other = given.get(part.name)
        if other is None:
            different.append(f"{part.name} is missing")
        elif (other.shape, other.dtype) != (part.shape, part.dtype):
            different.append(f"{part.name} is {_kind(other)}, not {_kind(part)}")
    if different:
        raise UserError(
            "the policy was trained on another observation than the environment "
            f"gives: {', '.join(different)}"
        )


def _kind(part: ObservationPart) -> str:
    return f"{part.dtype} {list(part.shape)}"


def _part(values: Any) -> ObservationPart:
    if not isinstance(values, Mapping) or {*values} != {*ObservationPart._fields}:
        expected = ", ".join(ObservationPart._fields)
        raise UserError(f"an observation part has {expected}, not {shown(values)}")
    name, shape, role = values["name"], values["shape"], values["role"]
    if not isinstance(name, str) or not name:
        raise UserError(
            f"the name of an observation part must be text, not {shown(name)}"
        )
    if not _is_shape(shape):
        raise UserError(
            f"observation part {name!r} has shape {shown(shape)}, expected a list of "
            "whole numbers"
        )
    if not _is_dtype(values["dtype"]):
        kind = shown(values["dtype"])
        raise UserError(
            f"observation part {name!r} has dtype {kind}, expected a numpy number type"
        )
    if role not in ROLES:
        known = ", ".join(ROLES)
        raise UserError(
            f"observation part {name!r} has role {shown(role)}, not {known}"
        )
    return ObservationPart(name, tuple(shape), values["dtype"], role)


def _is_shape(shape: Any) -> bool:
    return (
        isinstance(shape, list | tuple)
        and all(type(size) is int and 0 <= size < 2**31 for size in shape)
        and prod(shape) < 2**31
    )


def _is_dtype(dtype: Any) -> bool:
    return dtype in ("float32", "float64", "uint8", "int64", "bool")
