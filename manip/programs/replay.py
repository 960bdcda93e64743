"""`manip replay`: repeat the control step in which an environment's numbers failed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.table import Table
from rich.text import Text

from manip.envs.backends.native_batch import DUMP_FORMAT, NativeBatch
from manip.envs.faults import Fault
from manip.envs.task import Task
from manip.envs.task_registry import load_task_named_by
from manip.errors import UserError, one_line
from manip.io.printable import printable
from manip.io.tensor_trees import load_tree
from manip.programs import cli
from manip.programs.output import console
from manip.robot_config import RobotConfig

Motion = dict[str, tuple[float, float]]
"""Joint -> its first coordinate [m or rad] and the largest of its speeds."""


@dataclass(frozen=True)
class Replay:
    """Repeat the control step in which an environment's numbers were not finite.

    Runs store such steps in their folder `dumps`. The program prints the joints before
    and after the step, its action, and whether it fails again.
    """

    dump: Annotated[Path, tyro.conf.Positional]
    """File from a run's folder `dumps`."""


def main(arguments: Sequence[str]) -> int:
    """Replay the step; 0 if all numbers are finite this time, 1 if it fails again."""
    options = cli.parse(Replay, arguments, "manip replay")
    dump = load_tree(options.dump)
    if not isinstance(dump, dict) or dump.get("format") != DUMP_FORMAT:
        raise UserError(
            f"{options.dump} is no dump of format {DUMP_FORMAT}: name a file of a "
            "run's folder dumps, written by this version"
        )
    try:
        return _replay(dump, options.dump)
    except UserError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{options.dump} does not fit this version: {one_line(error)}"
        ) from error


def _replay(dump: dict[str, Any], path: Path) -> int:
    recorded = Fault(**dump["fault"])
    batch = _batch(dump, load_task_named_by(path.parent, dump["task"]))
    before = _motion(batch)
    batch.step(dump["action"][None])
    _print("then", str(recorded))
    console().print(_table(before, _motion(batch)))
    _print("action", np.array2string(dump["action"], precision=3))
    _print("now", "; ".join(map(str, batch.faults)) or "all numbers are finite")
    return 1 if batch.faults else 0


def _print(name: str, text: str) -> None:
    console().print(f"{name}: {printable(text)}", markup=False, highlight=False)


def _batch(dump: dict[str, Any], task: Task) -> NativeBatch:
    """One environment, in its state before the step."""
    robot = RobotConfig(**dump["robot"])
    options = {name: dump[name] for name in ("fidelity", "reward", "reward_weights")}
    batch = NativeBatch(task, 1, robot=robot, threads=1, **options)
    zero = np.zeros(1, np.int64)
    state = {"states": dump["state"][None], "readings": dump["readings"][None]}
    batch.load_state(state | {"elapsed": zero, "episode": zero, "fault_count": 0})
    return batch


def _motion(batch: NativeBatch) -> Motion:
    model, state = batch.scene.physics, batch.engine.states[0]
    return {
        joint.name: (
            float(state[joint.qposadr[0]]),
            float(np.abs(_velocities(state[model.nq :], joint)).max()),
        )
        for joint in (model.joint(index) for index in range(model.njnt))
    }


def _velocities(qvel: np.ndarray, joint: Any) -> np.ndarray:
    """Velocities of a joint: 6 of a free joint (type 0), 3 of a ball (1), else 1."""
    first, count = joint.dofadr[0], {0: 6, 1: 3}.get(int(joint.type[0]), 1)
    return qvel[first : first + count]


def _table(before: Motion, after: Motion) -> Table:
    table = Table("joint", "position", "speed", "position after", "speed after")
    for name in before:
        numbers = (f"{value:.4g}" for value in before[name] + after[name])
        table.add_row(Text(printable(name)), *numbers)
    return table
