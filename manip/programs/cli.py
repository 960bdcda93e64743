"""Command lines from documented dataclasses; mistakes become one line, exit code 2."""

import contextlib
import io
import re
import sys
from collections.abc import Callable, Sequence
from typing import TypeVar, cast

import tyro

from manip.errors import UserError, one_line

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
            parsed = tyro.cli(
                options,
                args=list(arguments),
                default=default,
                prog=program,
                config=(tyro.conf.AvoidSubcommands,),
            )
            return cast(Options, parsed)
        except SystemExit as leaving:
            if leaving.code:
                raise UserError(_one_line(said.getvalue())) from None
            raise


def run(program: Program, arguments: Sequence[str]) -> int:
    """Run a program; what the user or the system did wrong is one line, exit code 2."""
    try:
        return program(arguments)
    except UserError as error:
        print(f"manip: error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"manip: error: {one_line(error)}", file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"manip: error: not enough memory: {one_line(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("manip: interrupted", file=sys.stderr)
        return 130


def _one_line(box: str) -> str:
    """The message in tyro's box, drawn or in plain ASCII, without title and rules."""
    inside = "\n".join(line.strip("│╰╯ ") for line in box.splitlines()[1:])
    parts = re.split("^[─-]{5,}$", inside, flags=re.MULTILINE)
    sentences = [" ".join(part.split()) for part in parts if part.strip()]
    return "; ".join(sentences).replace("Argument helptext: ", "")
