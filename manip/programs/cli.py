"""Command lines from documented dataclasses; mistakes become one line, exit code 2."""

import contextlib
import io
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from typing import TypeVar, cast

import tyro

from manip.errors import UserError, at_least, one_line, out_of_memory
from manip.io.printable import printable
from manip.programs.output import lasting_output

Options = TypeVar("Options")

Program = Callable[[Sequence[str]], int]
"""Takes the arguments of a command line, returns the exit code."""

MISTAKE, INTERRUPTED = 2, 130
"""Exit codes: an error reported in one line, and Ctrl-C."""


def parse(
    options: type[Options],
    arguments: Sequence[str],
    program: str,
    default: Options | None = None,
) -> Options:
    """Read options from a command line; `default` gives the fields it leaves out.

    Raises:
        UserError: an option or value that does not exist, in one line.
        SystemExit: after --help.
    """

    def read(given: Sequence[str]) -> Options:
        parsed = tyro.cli(
            options,
            args=list(given),
            default=default,
            prog=program,
            config=(tyro.conf.AvoidSubcommands,),
        )
        return cast(Options, parsed)

    message = io.StringIO()
    with contextlib.redirect_stderr(message):
        try:
            return read(arguments)
        except SystemExit as leaving:
            if not leaving.code:
                raise
    raise UserError(_with_nearest_option(_one_line(message.getvalue()), read))


def run(program: Program, arguments: Sequence[str]) -> int:
    """Run a program; an error of the user or the system is one line, exit code 2.

    The exit code does not depend on whether the reader of stdout is still there.
    """
    with lasting_output() as failure:
        code = _run(program, arguments)
        error = failure()
        if error and not code:
            return _tell(f"cannot print: {one_line(error)}")
    return code


def check_range(option: str, value: int, least: int, most: int) -> None:
    """Raise `UserError` unless an option's whole number is from `least` to `most`."""
    at_least(least, option, value)
    if value > most:
        raise UserError(f"{option} must be at most {most}, not {value}")


def _run(program: Program, arguments: Sequence[str]) -> int:
    try:
        return program(arguments)
    except UserError as error:
        return _tell(str(error))
    except OSError as error:
        return _tell(one_line(error))
    except KeyboardInterrupt:
        print("manip: interrupted", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        if not out_of_memory(error):
            raise
        return _tell(f"not enough memory: {one_line(error)}")


def _tell(message: str) -> int:
    line = printable(" ".join(message.split()))
    print(f"manip: error: {line}", file=sys.stderr)
    return MISTAKE


def _one_line(box: str) -> str:
    """The message in tyro's box, drawn or in plain ASCII, without title and rules."""
    inside = "\n".join(line.strip("│╰╯ ") for line in box.splitlines()[1:])
    parts = re.split("^[─-]{5,}$", inside, flags=re.MULTILINE)
    sentences = [" ".join(part.split()) for part in parts if part.strip()]
    return "; ".join(sentences).replace("Argument helptext: ", "")


def _with_nearest_option(message: str, read: Callable[[Sequence[str]], object]) -> str:
    """Add "did you mean" to a message about an option for which tyro has no guess."""
    unknown = re.match(r"Unrecognized options: (--[\w.-]+)", message)
    if not unknown or "Perhaps you meant" in message:
        return message
    nearest = nearest_option(unknown[1], _options_in_help(read))
    return f"{message}; did you mean {nearest}?" if nearest else message


def _options_in_help(read: Callable[[Sequence[str]], object]) -> set[str]:
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        read(["--help"])
    return set(re.findall(r"--[a-z][\w.-]*\w", text.getvalue()))


def nearest_option(given: str, known: Iterable[str]) -> str | None:
    """The option that is meant: by its initials (--lr, learning-rate) or spelling."""
    names = {option.split(".")[-1].lstrip("-"): option for option in sorted(known)}
    wanted = given.split(".")[-1].lstrip("-").lower().replace("_", "-")
    initials = {"".join(w[0] for w in n.split("-") if w): n for n in sorted(names)}
    if wanted in initials:
        return names[initials[wanted]]
    close = get_close_matches(wanted, names, n=1)
    return names[close[0]] if close else None
