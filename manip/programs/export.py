"""`manip export`: write a policy as ONNX, TorchScript or numpy arrays."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro

from manip.agents.exports import SUFFIXES, Format, export_policy
from manip.agents.policy_card import PolicyCard
from manip.io.output_paths import check_output
from manip.io.printable import printable
from manip.programs import cli
from manip.training.card_interface import with_interface
from manip.training.final_evaluation import load_run


@dataclass(frozen=True)
class Export:
    """Write a policy for programs that do without manip (docs/export.md).

    The file holds the network, with the normaliser of the observations inside, and all
    that is needed to use it: the order of the inputs, formulas from measurements to
    observations, frames, units, the range of the actions. It is compared with the
    policy before it is written.
    """

    policy: Annotated[Path, tyro.conf.Positional]
    """Run folder, policy folder, or name of a shipped policy (see `manip list`)."""
    out: Path
    """File to write: .onnx, .pt (torchscript) or .npz (numpy)."""
    format: Format | None = None
    """That of the file's ending unless given. onnx: needs the extra `export`;
    torchscript: for torch.jit.load, also in C++; numpy: arrays, for policies that see
    the state. `manip.deploy` runs onnx and numpy."""


def main(arguments: Sequence[str]) -> int:
    """Write the file, and print how well it agrees with the policy."""
    options = cli.parse(Export, arguments, "manip export")
    kinds = [options.format] if options.format else [*SUFFIXES]
    endings = {SUFFIXES[kind]: kind for kind in kinds}
    check_output(options.out, "--out", endings)
    torch.set_num_threads(1)
    policy = with_interface(*load_run(options.policy))
    worst = export_policy(policy, endings[options.out.suffix], options.out)
    print(printable(f"{options.out}: actions equal the policy's to {worst:.0e}"))
    _note_missing_formulas(policy.card)
    return 0


def _note_missing_formulas(card: PolicyCard) -> None:
    """Say which parts of the observation cannot be computed from measurements."""
    parts = [part.name for part in card.observation_spec.parts if part.role != "camera"]
    missing = [name for name in parts if name not in card.formulas]
    if missing:
        print(
            f"manip: no formula gives {', '.join(missing)} from measurements: compute "
            "the observation yourself, as manip.deploy.runner cannot",
            file=sys.stderr,
        )
