"""Join a Ray cluster, where the package is installed and a cluster runs."""

import logging
from contextlib import suppress
from typing import Any

from manip.errors import UserError, one_line


def connected(address: str) -> Any:
    """Join the cluster at an address; return the package ray.

    Raises:
        UserError: Ray is not installed, or there is no cluster at the address.
    """
    try:
        import ray  # an optional extra
        import ray.util.scheduling_strategies
    except ImportError as error:
        raise UserError(
            "--ray needs the package ray: pip install ray (the extra `cluster`), on "
            "every machine of the cluster; or leave the option out"
        ) from error
    try:
        ray.init(
            address=address,
            log_to_driver=False,
            logging_level=logging.ERROR,
            configure_logging=False,
        )
    except (ConnectionError, OSError, RuntimeError, ValueError) as error:
        raise UserError(
            f"there is no Ray cluster at {address} ({one_line(error)}): start one with "
            "`ray start --head`, or name its address as host:port"
        ) from error
    _print_no_paragraphs(ray)
    return ray


def _print_no_paragraphs(ray: Any) -> None:
    """Keep Ray from printing a paragraph for each lost process, as its debugger does.

    There is no option for it. Those who lose a process say so in a line.
    """
    with suppress(AttributeError):
        ray._private.worker._worker_logs_enabled = False
