"""`manip doctor`: check whether this machine can train, evaluate and render."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass

from rich.table import Table
from rich.text import Text

from manip.io.printable import printable
from manip.programs import cli
from manip.programs.doctor_checks import CHECKS, Check
from manip.programs.output import console


@dataclass(frozen=True)
class Doctor:
    """Check that this machine can train, evaluate and render.

    The exit code is 0 if every required check passes, else 1.
    """

    json: bool = False
    """Print JSON instead of a table."""


def main(arguments: Sequence[str]) -> int:
    """Check this machine; 0 if it can run manip, else 1."""
    return run(cli.parse(Doctor, arguments, "manip doctor"))


def run(options: Doctor) -> int:
    """Print the checks; return 0 if every required one passes, else 1."""
    checks = [check() for check in CHECKS]
    fit = all(check.ok for check in checks if check.required)
    if options.json:
        print(json.dumps({"fit": fit, "checks": [asdict(c) for c in checks]}, indent=2))
    else:
        _print_report(checks, fit)
    return 0 if fit else 1


def _print_report(checks: Iterable[Check], fit: bool) -> None:
    table = Table("check", "", "result", box=None)
    for check in checks:
        table.add_row(check.name, _mark(check), Text(printable(check.detail)))
    console().print(table)
    for check in checks:
        if not check.ok:
            text = f"{check.name}: {check.remedy}"
            console().print(text, markup=False, soft_wrap=True)
    console().print("fit" if fit else "not fit: mend what failed, then run this again")


def _mark(check: Check) -> str:
    if check.ok:
        return "[green]ok[/green]"
    return "[red]FAIL[/red]" if check.required else "[yellow]note[/yellow]"
