"""TensorBoard events of a run: its options, and a row of scalars at a time."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tensorboard.compat.proto.summary_pb2 import Summary
from torch.utils.tensorboard import FileWriter
from torch.utils.tensorboard.summary import hparams, text

from manip.io.yaml_files import dump_yaml

RESULTS = {"eval/success_held": 0.0, "eval/return": 0.0}
"""Scalars that TensorBoard's HPARAMS tab shows beside the options of each run."""


class TensorboardLog:
    """Writes the events of a run anew: those of an earlier process are removed.

    Args:
        folder: the run folder; the events are in `tensorboard/` in it.
        options: of the run, as plain values. They are shown as text (TEXT tab, as YAML)
            and in the table of runs (HPARAMS tab).
    """

    def __init__(self, folder: Path, options: Mapping[str, Any]) -> None:
        events = folder / "tensorboard"
        for path in events.glob("events.out.tfevents.*"):
            path.unlink()
        self._file = FileWriter(str(events))
        shown = "".join(f"    {line}\n" for line in dump_yaml(options).splitlines())
        self._file.add_summary(text("options", shown), 0)
        for part in hparams(_flat(options), RESULTS):
            self._file.add_summary(part)

    def write(self, row: Mapping[str, float]) -> None:
        """Write the scalars of a row at its `env_steps`."""
        values = [
            Summary.Value(tag=name, simple_value=value)
            for name, value in row.items()
            if name != "env_steps"
        ]
        self._file.add_summary(Summary(value=values), int(row["env_steps"]))

    def close(self) -> None:
        """Write what is not written yet, and close the file."""
        self._file.close()


def _flat(options: Mapping[str, Any]) -> dict[str, bool | float | str]:
    """Options as one table: those of a group as group.name, lists as text."""
    flat: dict[str, bool | float | str] = {}
    for name, value in options.items():
        if isinstance(value, Mapping):
            flat |= {f"{name}.{inner}": v for inner, v in _flat(value).items()}
        else:
            flat[name] = value if isinstance(value, bool | int | float) else str(value)
    return flat
