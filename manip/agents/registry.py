"""Algorithms by name: entry points, or `package.module:Class`."""

from dataclasses import is_dataclass
from pathlib import Path

from manip.agents.agent import Agent, AgentConfig
from manip.errors import UserError
from manip.plugins import check_origin, load_class, plugin_names

GROUP = "manip.algorithms"
"""Entry-point group under which a package offers its algorithms."""


def algorithm_names() -> list[str]:
    """Names of all algorithms that installed packages offer."""
    return plugin_names(GROUP)


def load_algorithm(name: str) -> type[Agent]:
    """Import the algorithm called `name`, or the class at `package.module:Class`.

    Modules are searched in the working directory and among installed packages.

    Raises:
        UserError: there is no such algorithm, or the class is not a complete
            subclass of `Agent`; the message lists what is missing.
    """
    return _checked(name, load_class(name, GROUP, "algorithm"))


def check_algorithm_origin(name: str, folder: Path) -> None:
    """Refuse an algorithm, named by a file in `folder`, whose code lies in there too.

    Raises:
        UserError: importing the algorithm would run code that came with the file.
    """
    check_origin(name, GROUP, "algorithm", folder)


def _checked(name: str, cls: type) -> type[Agent]:
    if not issubclass(cls, Agent):
        raise UserError(
            f"algorithm {name!r} must be a subclass of manip.agents.agent.Agent, "
            f"not {cls!r}"
        )
    missing = sorted(cls.__abstractmethods__)
    missing += [needed for needed in ("name", "Config") if not hasattr(cls, needed)]
    if missing:
        raise UserError(f"algorithm {name!r} does not define {', '.join(missing)}")
    options = cls.Config
    if not (is_dataclass(options) and issubclass(options, AgentConfig)):
        raise UserError(
            f"algorithm {name!r}: Config must be a frozen dataclass and a subclass of "
            f"manip.agents.agent.AgentConfig, not {options!r}"
        )
    return cls
