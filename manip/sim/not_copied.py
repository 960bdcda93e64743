"""Base classes of objects that must not be copied or pickled."""

import copy
from typing import Any, NoReturn, Self

from manip.errors import UserError


class NotCopied:
    """Base class of objects with native memory or another library's simulation.

    A copy would share that memory, or keep addresses of another process: stepping it
    would move the original. copy.copy, copy.deepcopy and pickle raise `UserError`;
    subclasses that can be copied rightly define `__deepcopy__`.
    """

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        kind = type(self).__name__
        raise UserError(f"{kind} can be neither copied nor pickled: build another one")


class DeepCopied(NotCopied):
    """Base class of objects that allow deep copies only, member by member."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Copy every member, each as its own class defines."""
        twin = object.__new__(type(self))
        memo[id(self)] = twin
        vars(twin).update(copy.deepcopy(vars(self), memo))
        return twin
