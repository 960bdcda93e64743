"""Refuse copies of what a copy would share or lose."""

import copy
from typing import Any, NoReturn, Self

from manip.errors import UserError


class NotCopied:
    """Base of what holds native memory or another library's simulation.

    A copy would share that memory, or keep addresses of another process: stepping it
    would move the original. copy.copy, copy.deepcopy and pickle raise `UserError`;
    subclasses that can be copied rightly define `__deepcopy__`.
    """

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        kind = type(self).__name__
        raise UserError(f"{kind} can be neither copied nor pickled: build another one")


class DeepCopied(NotCopied):
    """Base of what can be deep-copied member by member, but not copied otherwise."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Copy every member, each as its own class defines."""
        twin = object.__new__(type(self))
        memo[id(self)] = twin
        vars(twin).update(copy.deepcopy(vars(self), memo))
        return twin
