"""RunRecord: what the folder of a run, or a policy, says about its training."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from manip.agents.policy import Policy
from manip.envs.task import Task
from manip.errors import UserError
from manip.io.printable import printable
from manip.training.config import TrainConfig, recorded
from manip.training.final_evaluation import load_run
from manip.training.reward_weights import parse_weights
from manip.training.run_logs import read_numbers


@dataclass(frozen=True)
class RunRecord:
    """A trained policy and the record of its training.

    Attributes:
        path: run folder, policy folder or shipped name, as it was given.
        config: options of the training; None if they are not recorded.
        rows: rows of metrics.csv; see `read_numbers`.
        note: why the record of the training is missing, else "".
        parts: number of the last parts of the path that are its name.
    """

    path: Path
    policy: Policy
    task: Task
    config: TrainConfig | None
    rows: list[dict[str, float]]
    note: str = ""
    parts: int = 1

    @property
    def name(self) -> str:
        """Short name, for legends and headings."""
        last = "/".join(self.path.parts[-self.parts :])
        return printable(last or str(self.path))

    @property
    def title(self) -> str:
        """Task, arm and algorithm."""
        card = self.policy.card
        return f"{card.task} · {card.robot} · {card.method.upper()}"

    @property
    def seconds(self) -> float | None:
        """Wall time of the training [s]; None if it is not recorded."""
        return self.rows[-1].get("seconds") if self.rows else None

    @property
    def reward_set(self) -> str:
        """Reward set of the training; "shaped" if unknown."""
        known = self.config.reward if self.config else "shaped"
        return known if known in self.task.weights else next(iter(self.task.weights))

    @property
    def reward_weights(self) -> dict[str, float]:
        """Term -> weight that the training paid."""
        given = parse_weights(self.config.reward_weights) if self.config else {}
        return {**self.task.weights[self.reward_set], **given}


def load_records(runs: Sequence[Path]) -> list[RunRecord]:
    """Read several; their names have as many parts of the paths as make them differ.

    Raises:
        UserError: as `load_record`.
    """
    parts, longest = 1, max(len(run.parts) for run in runs)
    while parts < longest and len({run.parts[-parts:] for run in runs}) < len(runs):
        parts += 1
    return [replace(load_record(run), parts=parts) for run in runs]


def load_record(run: Path) -> RunRecord:
    """Read a run folder, a policy folder, or the name of a shipped policy.

    Raises:
        UserError: there is no such policy or task, or metrics.csv is damaged.
    """
    policy, task = load_run(run)
    if not (run / "config.yaml").is_file():
        note = "a policy alone has no record of its training"
        return RunRecord(run, policy, task, None, [], note)
    rows = read_numbers(run / "metrics.csv")
    try:
        return RunRecord(run, policy, task, recorded(run), rows)
    except UserError as error:  # options of an older version
        return RunRecord(run, policy, task, None, rows, str(error))
