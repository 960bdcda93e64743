"""Make other libraries log errors only: in a context, or in a whole program."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

_LOGGER = "robosuite_logs"
"""Name of robosuite's logger (robosuite/utils/log_utils.py)."""


def quiet_robosuite() -> None:
    """Make robosuite log errors only, in this process, from now on.

    For programs only: a library must not change the logs of its user.
    """
    logging.getLogger(_LOGGER).addFilter(_is_error)


@contextmanager
def quiet(logger: str = _LOGGER) -> Iterator[None]:
    """Make a logger (robosuite's by default) pass errors only, in a `with` block."""
    log = logging.getLogger(logger)

    def block(record: logging.LogRecord) -> bool:
        return _is_error(record)

    log.addFilter(block)
    try:
        yield
    finally:
        log.removeFilter(block)


def _is_error(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.ERROR
