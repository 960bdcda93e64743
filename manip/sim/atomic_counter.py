"""A counter that threads share without a lock, to divide work among them."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic
def take_number(typing: Any, counter: Any) -> Any:
    """Add one to the int64 at an address and return its value before, atomically.

    No two threads get the same number. Called from compiled code as
    `take_number(address)`.
    """

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
        one = ir.Constant(ir.IntType(64), 1)
        return builder.atomic_rmw("add", pointer, one, "seq_cst")

    return types.int64(types.intp), lower
