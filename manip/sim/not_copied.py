"""Refuse copies of objects that only one Python object may own."""

from typing import NoReturn

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
