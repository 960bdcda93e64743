"""Command lines from documented dataclasses; mistakes become one line, exit code 2."""

import contextlib
import io
import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

import tyro

from manip.errors import UserError

Options = TypeVar("Options")

Program = Callable[[Sequence[str]], int]
"""Takes a command line's arguments, returns the exit code."""


def parse(
    options: type[Options],
    arguments: Sequence[str],
    program: str,
    default: Options | None = None,
) -> Options:
    """Options from a command line; fields of `default` where it says nothing.

    Raises:
        UserError: an option or value that does not exist, in one line.
        SystemExit: after --help.
    """
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        try:
            return tyro.cli(
                options,
                args=list(arguments),
                default=default,  # type: ignore[arg-type]
                prog=program,
                config=(tyro.conf.AvoidSubcommands,),
            )
        except SystemExit as leaving:
            if leaving.code:
                raise UserError(_one_line(said.getvalue())) from None
            raise


def run(program: Program, arguments: Sequence[str]) -> int:
    """Run a program; a `UserError` is printed as one line and gives exit code 2."""
    try:
        return program(arguments)
    except UserError as error:
        print(f"manip: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("manip: interrupted", file=sys.stderr)
        return 130


def _one_line(box: str) -> str:
    """The message in tyro's box, without its frame, rules and repeated help."""
    lines = [line.strip("│ ") for line in box.splitlines()]
    words = [line for line in lines if line and line[0] not in "╭╰─"]
    return " ".join(words).replace(" Argument helptext:", ";")
