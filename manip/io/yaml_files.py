"""YAML files of plain values: read safely in bounded time, written readably."""

from pathlib import Path
from typing import Any

import yaml

from manip.errors import UserError, one_line

LARGEST = 2**18
"""Bytes of the largest file that is read."""


class _PlainLoader(yaml.SafeLoader):
    """Loads plain values only: no aliases, no merge keys, no key twice.

    With nested aliases and merge keys, a few lines define billions of values.
    """

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise _error("anchors and aliases (&, *) are not allowed", event)
        return super().compose_node(parent, index)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                raise _error("merge keys (<<) are not allowed", key)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        mapping = super().construct_mapping(node, deep=deep)
        if len(mapping) < len(node.value):
            raise _error("a key stands there twice", node)
        return mapping


class _TextLoader(_PlainLoader):
    """Leaves numbers, dates and the like as the text that stands in the file."""

    yaml_implicit_resolvers: dict[Any, Any] = {}


class _PlainDumper(yaml.SafeDumper):
    """Writes equal values out in full, each time."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def read_yaml(path: Path, as_text: bool = False) -> Any:
    """The plain values of a YAML file.

    Args:
        path: the file.
        as_text: leave numbers, dates and the like as the text that stands in the file.

    Raises:
        UserError: it is damaged, too large, no regular file, or holds aliases, merge
            keys or a key twice.
        OSError: it cannot be read.
    """
    if path.exists() and not path.is_file():
        raise UserError(f"{path} is not a regular file")
    if path.stat().st_size > LARGEST:
        raise UserError(f"{path} is larger than {LARGEST:,} bytes")
    try:
        return parse_yaml(path.read_text(encoding="utf-8"), as_text)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise UserError(f"{path} is damaged: {one_line(error)}") from error


def parse_yaml(text: str, as_text: bool = False) -> Any:
    """The plain values of a YAML text; see `read_yaml`.

    Raises:
        yaml.YAMLError, ValueError, TypeError, RecursionError: it is not plain YAML.
    """
    return yaml.load(text, _TextLoader if as_text else _PlainLoader)


def dump_yaml(values: Any) -> str:
    """Plain values as YAML text, keys in alphabetical order."""
    return yaml.dump(values, Dumper=_PlainDumper)


def _error(problem: str, at: Any) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(None, None, problem, at.start_mark)
