"""Grids of training options: every combination of the values is one run.

A grid is written as on a command line, `--algo sac td3 --seed 0:5`, or as YAML. An
option that holds one value has a choice for each word. An option that holds a list has
one choice; give it several times for several.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from itertools import product
from math import prod
from types import UnionType
from typing import Any, cast, get_args, get_origin, get_type_hints

from manip.agents.registry import load_algorithm
from manip.errors import UserError, shown
from manip.training.config import TrainConfig

Words = tuple[str, ...]
"""What follows an option: one choice of its value."""

Grid = dict[str, list[Words]]
"""Option without dashes -> its choices."""

MOST_CELLS = 10_000

REFUSED = ("out", "resume", "help", "preferences")
"""Options of `manip train` that a sweep sets itself, or that make no sense in it: runs
that add comparisons to one folder would learn from each other's, in a random order."""

_FLAGS: dict[Words, str] = {("true",): "--{}", ("false",): "--no-{}"}
"""Choices of an option that is on or off."""


@dataclass(frozen=True)
class Cell:
    """One combination of a grid.

    Attributes:
        values: option -> its value as text, for all options of the grid but the seed.
        seed: seed of the run.
        arguments: of `manip train`, without the seed.
    """

    values: Mapping[str, str]
    seed: int
    arguments: Words


def grid_of_arguments(arguments: Sequence[str]) -> Grid:
    """The grid of a command line.

    Raises:
        UserError: a word belongs to no option, or an option has no value.
    """
    given: dict[str, list[Words]] = {}
    for option, words in split_options(arguments):
        name = option.removeprefix("--")
        if not words:
            name, words = name.removeprefix("no-"), (_flag(name),)
        given.setdefault(_normal(name), []).append(words)
    return _grid(given)


def _flag(name: str) -> str:
    return "false" if name.startswith("no-") else "true"


def grid_of_mapping(values: Mapping[str, Any]) -> Grid:
    """The grid of a mapping from YAML, whose values are text or lists of text.

    Raises:
        UserError: a value is neither.
    """
    given = {}
    for name, value in _flat(values):
        items = value if isinstance(value, list) else [value]
        if not items:
            raise UserError(f"{name} has no value")
        nested = any(isinstance(item, list) for item in items)
        choices = [_words(name, item) for item in items]
        given[_normal(name)] = choices if nested else [tuple(w for (w,) in choices)]
    return _grid(given)


def _flat(values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Options, with those of a nested mapping as outer.inner."""
    if not isinstance(values, Mapping):
        raise UserError(f"a grid must be a mapping of options, not {shown(values)}")
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}.{inner}", v) for inner, v in _flat(value))
        else:
            yield name, value


def _words(name: str, item: Any) -> Words:
    words = tuple(item) if isinstance(item, list) else (item,)
    if not words or not all(isinstance(word, str) for word in words):
        raise UserError(
            f"{name} must be a value or a list of values, not {shown(item)}"
        )
    return words


def split_options(arguments: Sequence[str]) -> Iterator[tuple[str, Words]]:
    """Options with the words that follow each; `--a=b` is `--a b`.

    Raises:
        UserError: a word precedes all options.
    """
    option, words = "", []
    for argument in arguments:
        if not argument.startswith("--"):
            if not option:
                raise UserError(f"{argument!r} belongs to no option: see --help")
            words.append(argument)
            continue
        if option:
            yield option, tuple(words)
        option, equals, value = argument.partition("=")
        words = [value] if equals else []
    if option:
        yield option, tuple(words)


def _normal(name: str) -> str:
    return name.replace("_", "-")


def _grid(given: Mapping[str, list[Words]]) -> Grid:
    """Split the words of options that hold one value; expand ranges of seeds."""
    for name in REFUSED:
        if name in given:
            raise UserError(f"--{name} cannot be an option of a grid")
    lists = _list_options(given)
    grid: Grid = {}
    for name, choices in given.items():
        if name in lists:
            grid[name] = choices
        else:
            grid[name] = [(word,) for words in choices for word in words]
    if "seed" in grid:
        grid["seed"] = [(str(seed),) for seed in _seeds(grid["seed"])]
    return grid


def plain_grid(grid: Grid) -> dict[str, Any]:
    """The grid as a mapping for YAML, which `grid_of_mapping` reads."""
    lists = _list_options(grid)
    plain: dict[str, Any] = {}
    for name, choices in grid.items():
        words = [list(words) if name in lists else words[0] for words in choices]
        plain[name] = words[0] if name not in lists and len(words) == 1 else words
    return plain


def _list_options(given: Mapping[str, list[Words]]) -> set[str]:
    """Names of the options that hold a list, for one of the algorithms or more."""
    algos = [word for words in given.get("algo", [("sac",)]) for word in words]
    groups = [("agent.", load_algorithm(algo).Config) for algo in algos]
    return {name for group in [("", TrainConfig), *groups] for name in _lists(*group)}


def _lists(prefix: str, options: type) -> Iterator[str]:
    for name, hint in get_type_hints(options).items():
        if is_dataclass(hint):
            yield from _lists(f"{_normal(name)}.", cast(type, hint))
        elif _is_list(hint):
            yield prefix + _normal(name)


def _is_list(hint: Any) -> bool:
    if get_origin(hint) is UnionType:
        return any(map(_is_list, get_args(hint)))
    return get_origin(hint) in (tuple, list)


def _seeds(choices: Sequence[Words]) -> Iterator[int]:
    """Seeds of words such as 3 or 0:5, the second of which is 0 to 4."""
    for (word,) in choices:
        match = re.fullmatch(r"(\d{1,10})(?::(\d{1,10}))?", word)
        if not match:
            raise UserError(f"--seed takes numbers or ranges such as 0:5, not {word!r}")
        first = int(match[1])
        last = first + 1 if match[2] is None else int(match[2])
        if not 0 < last - first <= MOST_CELLS:
            raise UserError(f"--seed {word} must be 1 to {MOST_CELLS:,} seeds")
        yield from range(first, last)


def cells_of(grid: Grid) -> list[Cell]:
    """All combinations, the seed (0 unless given) fastest, then the last option.

    Raises:
        UserError: there are too many.
    """
    count = prod(map(len, grid.values()))
    if count > MOST_CELLS:
        raise UserError(f"a grid of {count:,} runs: at most {MOST_CELLS:,} are allowed")
    options = [name for name in grid if name != "seed"]
    return [
        Cell(_values(options, words), int(seed), _arguments(options, words))
        for words in product(*(grid[name] for name in options))
        for (seed,) in grid.get("seed", [("0",)])
    ]


def _values(options: Sequence[str], words: Sequence[Words]) -> dict[str, str]:
    return {n: " ".join(word) for n, word in zip(options, words, strict=True)}


def _arguments(options: Sequence[str], words: Sequence[Words]) -> Words:
    """The combination as arguments of `manip train`."""
    pairs = zip(options, words, strict=True)
    return tuple(argument for pair in pairs for argument in _argument(*pair))


def _argument(option: str, words: Words) -> Words:
    flag = _FLAGS.get(words)
    return (flag.format(option),) if flag else (f"--{option}", *words)
