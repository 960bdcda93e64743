"""Traced: an array that records how it was computed from named measurements.

A task's `measure` and `observe` compute with arrays [N, k] of all environments. Given
`Traced` arrays, they return arrays whose `text` is a formula for one environment, in
the language of `manip.deploy.formulas`. What has no formula there has the text "".
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

Array = np.ndarray

INFIX: dict[Any, str] = {
    np.add: "+", np.subtract: "-", np.multiply: "*", np.true_divide: "/",
    np.less: "<", np.less_equal: "<=", np.greater: ">", np.greater_equal: ">=",
    np.equal: "==", np.not_equal: "!=", np.matmul: "@",
    np.logical_and: "&", np.bitwise_and: "&", np.logical_or: "|", np.bitwise_or: "|",
}  # fmt: skip
PREFIX: dict[Any, str] = {np.negative: "-", np.invert: "~", np.logical_not: "~"}
CALLS: dict[Any, str] = {
    function: function.__name__
    for function in (
        *(np.arctan2, np.cos, np.exp, np.hypot, np.maximum, np.minimum, np.sin),
        *(np.sqrt, np.tanh, np.where, np.clip, np.cross, np.round),
    )
} | {np.absolute: "abs"}
"""Functions that mean the same for arrays [N, k] and [k]."""
ROWWISE: dict[Any, str] = {
    np.all: "all", np.any: "any", np.sum: "sum", np.mean: "mean", np.linalg.norm: "norm"
}  # fmt: skip
"""Functions that reduce the last axis, if called with axis=1 or axis=-1."""


class Traced(NDArrayOperatorsMixin):
    """An array [N, ...] and its formula.

    Args:
        value: the numbers of N environments.
        text: the formula for one environment; "" if there is none.
        items: formulas of the entries, where they were stacked.
    """

    def __init__(self, value: Any, text: str, items: tuple[str, ...] = ()) -> None:
        self.value, self.text, self.items = np.asarray(value), text, items

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape with the environments, [N, ...]."""
        return self.value.shape

    @property
    def ndim(self) -> int:
        """Number of axes, the environments' included."""
        return self.value.ndim

    @property
    def T(self) -> "Traced":  # noqa: N802
        """The transpose; only its rows have formulas."""
        return Traced(self.value.T, "", _items_of(self))

    def __len__(self) -> int:
        return len(self.value)

    def __iter__(self) -> Iterator["Traced"]:
        rows = self.items or [""] * len(self.value)
        for value, text in zip(self.value, rows, strict=True):
            yield Traced(value, text)

    def __getitem__(self, index: Any) -> "Traced":
        return Traced(self.value[index], *_indexed(self, index))

    def astype(self, dtype: Any) -> "Traced":
        """The same formula: numbers and flags are not told apart."""
        return Traced(self.value.astype(dtype), self.text, self.items)

    def reshape(self, *shape: Any) -> "Traced":
        """Rows of nine as matrices [N, 3, 3]; other shapes have no formula."""
        value = self.value.reshape(*shape)
        matrices = value.shape == (len(self), 3, 3)
        return Traced(value, _call("matrix", [self.text]) if matrices else "")

    def all(self, axis: int) -> "Traced":
        """As np.all."""
        return self.__array_function__(np.all, (), (self,), {"axis": axis})

    def any(self, axis: int) -> "Traced":
        """As np.any."""
        return self.__array_function__(np.any, (), (self,), {"axis": axis})

    def sum(self, axis: int) -> "Traced":
        """As np.sum."""
        return self.__array_function__(np.sum, (), (self,), {"axis": axis})

    def mean(self, axis: int) -> "Traced":
        """As np.mean."""
        return self.__array_function__(np.mean, (), (self,), {"axis": axis})

    def __array__(self, dtype: Any = None, copy: Any = None) -> Array:
        return np.asarray(self.value, dtype)

    def __array_ufunc__(
        self, ufunc: Any, method: str, *inputs: Any, **options: Any
    ) -> "Traced":
        value = getattr(ufunc, method)(*map(_value, inputs), **options)
        if method != "__call__" or options:
            return Traced(value, "")
        return Traced(value, _ufunc_text(ufunc, inputs, len(self)))

    def __array_function__(
        self, function: Any, types: Any, args: Any, options: Any
    ) -> Any:
        value = function(*_values(args), **_values(options))
        if function is np.shape or not isinstance(value, Array):
            return value
        text, items = _function_text(function, args, options, len(self))
        return Traced(value, text, items)


def _value(item: Any) -> Any:
    return item.value if isinstance(item, Traced) else item


def _values(node: Any) -> Any:
    """A tree of arguments with the numbers in place of traced arrays."""
    if isinstance(node, Mapping):
        return {name: _values(item) for name, item in node.items()}
    if isinstance(node, list | tuple):
        return type(node)(_values(item) for item in node)
    return _value(node)


def _items_of(traced: Traced) -> tuple[str, ...]:
    """Formulas of the entries of [N, k]."""
    if traced.items or traced.ndim != 2:
        return traced.items
    return tuple(
        f"{traced.text}[{index}]" if traced.text else ""
        for index in range(traced.shape[1])
    )


def text_of(item: Any, rows: int) -> str:
    """The formula of an argument: traced, or numbers equal for all environments."""
    if isinstance(item, Traced):
        return item.text
    numbers = np.asarray(item)
    if numbers.dtype.kind not in "biuf" or not np.isfinite(numbers).all():
        return ""
    if numbers.ndim and len(numbers) == rows:  # a row for each environment
        return text_of(numbers[0], rows) if (numbers == numbers[0]).all() else ""
    if numbers.size == 1:
        numbers = numbers.reshape(())
    if numbers.ndim > 1 and len(numbers) == 1:
        numbers = numbers[0]
    return str(numbers.tolist()) if numbers.ndim < 2 else ""


def _ufunc_text(ufunc: Any, inputs: Any, rows: int) -> str:
    texts = [text_of(item, rows) for item in inputs]
    if not all(texts):
        return ""
    if ufunc in INFIX:
        return f"({texts[0]} {INFIX[ufunc]} {texts[1]})"
    if ufunc in PREFIX:
        return f"({PREFIX[ufunc]}{texts[0]})"
    if ufunc is np.square:
        return f"({texts[0]} * {texts[0]})"
    return _call(CALLS[ufunc], texts) if ufunc in CALLS else ""


def _call(name: str, texts: list[str]) -> str:
    return f"{name}({', '.join(texts)})" if all(texts) else ""


def _function_text(
    function: Any, args: Any, options: Any, rows: int
) -> tuple[str, tuple[str, ...]]:
    """Formula of a numpy function's result, and those of its entries if stacked."""
    along_row = options in ({"axis": 1}, {"axis": -1})
    if function is np.stack and along_row:
        items = tuple(text_of(item, rows) for item in args[0])
        flat = all(np.ndim(_value(item)) == 1 for item in args[0])
        return _call("stack", list(items)), items if flat else ()
    if function in (np.concatenate, np.hstack, np.column_stack):
        if function is np.concatenate and not along_row:
            return "", ()
        texts = [text_of(item, rows) for item in args[0]]
        one = [np.ndim(_value(item)) == 1 for item in args[0]]
        parts = [
            f"vector({t})" if o and t else t for t, o in zip(texts, one, strict=True)
        ]
        return _call("concat", parts), ()
    if function in ROWWISE and along_row and np.ndim(_value(args[0])) == 2:
        return _call(ROWWISE[function], [text_of(args[0], rows)]), ()
    if function in CALLS and not options:
        return _call(CALLS[function], [text_of(item, rows) for item in args]), ()
    return "", ()


def _indexed(traced: Traced, index: Any) -> tuple[str, tuple[str, ...]]:
    """Formulas of traced[index] and its entries."""
    if isinstance(index, int) and traced.items and not traced.text:  # a row of `.T`
        return traced.items[index], ()
    if not isinstance(index, tuple) or len(index) != 2 or index[0] != slice(None):
        return "", ()
    entry = index[1]
    if entry is None and traced.ndim == 1:
        return _call("vector", [traced.text]), ()
    if traced.ndim != 2 or not isinstance(entry, int | slice | list):
        return "", ()
    if isinstance(entry, int):
        return _items_of(traced)[entry], ()
    if isinstance(entry, list):
        entries = tuple(_items_of(traced)[i] for i in entry)
        return _call("stack", list(entries)), entries
    if traced.items:
        return _call("stack", list(traced.items[entry])), traced.items[entry]
    ends = [str(end) if end is not None else "" for end in (entry.start, entry.stop)]
    return (f"{traced.text}[{':'.join(ends)}]" if traced.text else ""), ()
