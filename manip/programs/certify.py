"""`manip certify`: compare a task on C, on MuJoCo Warp and in stock robosuite."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from manip.evaluation.statistics import Rate
from manip.io.atomic_files import write_text
from manip.io.output_paths import check_output
from manip.io.printable import printable
from manip.programs import cli
from manip.programs.output import console
from manip.sim.warp.library import Device
from manip.training.certificate import Certificate, CertificateOptions, certify

MOST = 10_000


@dataclass(frozen=True)
class Certify:
    """Compare a task on MuJoCo's C code, on MuJoCo Warp and in stock robosuite.

    The expert and the shipped policy run on all three: on C and on Warp in the same
    episodes, in stock robosuite in episodes that it samples. States on C and Warp are
    compared after 1, 10 and 50 equal random steps, contacts in states of the expert.
    The last lines say from which engine a result may be quoted. The exit code is 0 if
    C equals robosuite and Warp is within tolerance of C, else 1. Needs the extra gpu.
    """

    task: Annotated[str, tyro.conf.Positional]
    """Task (see `manip list`), or package.module:Class."""
    robot: str = "Panda"
    """Robot arm."""
    device: Device = "cuda"
    """Device of MuJoCo Warp; cpu is slow."""
    episodes: int = 64
    """Episodes of each policy on C and on Warp."""
    stock_episodes: int = 20
    """Episodes of each policy in stock robosuite; 0 for none."""
    json: Path | None = None
    """File for the certificate as JSON."""


def main(arguments: Sequence[str]) -> int:
    """Compare, print tables and verdict; 0 if all engines agree, else 1."""
    options = cli.parse(Certify, arguments, "manip certify")
    cli.check_range("--episodes", options.episodes, 1, MOST)
    cli.check_range("--stock-episodes", options.stock_episodes, 0, MOST)
    if options.json:
        check_output(options.json, "--json")
    torch.set_num_threads(1)
    result = certify(_chosen(options), _say)
    if options.json:
        write_text(options.json, result.to_json())
    for table in (_success(result), _differences(result), _contacts(result)):
        console().print(table)
    for line in verdict(result):
        console().print(printable(line), markup=False, soft_wrap=True)
    return 0 if result.exact and result.trains else 1


def verdict(result: Certificate) -> Iterator[str]:
    """Which engine a result may be quoted from, in lines."""
    yield from (f"C differs from stock robosuite: {p}" for p in result.stock_problems)
    if result.exact:
        yield "quote results from: stock robosuite, or the native engine (equal to it)"
    else:
        yield "quote results from: stock robosuite only"
    if result.trains:
        yield "warp: train on it; do not quote results from it (docs/gpu.md)"
    else:
        yield "warp: too far from C here: what is learned on it may not hold on C"


def _chosen(options: Certify) -> CertificateOptions:
    return CertificateOptions(
        options.task,
        options.robot,
        options.device,
        options.episodes,
        options.stock_episodes,
    )


def _say(text: str) -> None:
    Console(stderr=True).print(f"manip: {printable(text)}", markup=False)


def _success(result: Certificate) -> Table:
    title = f"{result.task} · {result.robot} · success_held [%], 95 % interval"
    table = Table("policy", "C", "Warp", "stock", "equal flags", title=Text(title))
    for policy, rates in result.success.items():
        cells = [_rate(rates.get(env)) for env in ("native", "warp", "stock")]
        table.add_row(policy, *cells, f"{result.equal_flags[policy]:.1%}")
    return table


def _contacts(result: Certificate) -> Table:
    columns = ("pair", "contacts C", "Warp", "pairs", "difference of depth [m]")
    beyond = ("missed on Warp", "deepest [m]", "only on Warp", "deepest [m]")
    title = Text("contacts in the expert's states")
    table = Table(*columns, *beyond, title=title)
    for kind, one in sorted(result.contacts.items()):
        cells = [str(one.native), str(one.warp), str(one.pairs), f"{one.depth:.1e}"]
        for depths in (one.missed, one.ghosts):
            cells += [str(len(depths)), f"{max(depths):.1e}" if depths else "-"]
        table.add_row(kind, *cells)
    return table


def _rate(rate: Rate | None) -> str:
    if rate is None:
        return "-"
    return f"{100 * rate.rate:.1f} ({100 * rate.low:.0f}-{100 * rate.high:.0f})"


def _differences(result: Certificate) -> Table:
    table = Table(title=Text("arm's joints, Warp against C"))
    table.add_column("control steps", justify="right")
    for column in ("median difference [rad]", "largest"):
        table.add_column(column, justify="right")
    for steps, (median, most) in result.differences.items():
        table.add_row(str(steps), f"{median:.1e}", f"{most:.1e}")
    return table
