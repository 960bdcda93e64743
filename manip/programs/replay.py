"""`manip replay`: take the step again in which a world's numbers went wrong."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from manip.envs.backends.native_batch import DUMP_FORMAT, NativeBatch
from manip.envs.faults import Fault
from manip.envs.task import Task
from manip.envs.task_registry import load_task_named_by
from manip.errors import UserError, one_line
from manip.io.tensor_trees import load_tree
from manip.programs import cli
from manip.robot_config import RobotConfig


@dataclass(frozen=True)
class Replay:
    """Take the step again in which a world's numbers went wrong.

    Runs keep such steps in their folder `dumps`. Shown are the world before the step,
    its action, and whether the same goes wrong again.
    """

    dump: Annotated[Path, tyro.conf.Positional]
    """File from a run's folder `dumps`."""


def main(arguments: Sequence[str]) -> int:
    """Replay the step; 0 if all was well this time, 1 if it went wrong again."""
    options = cli.parse(Replay, arguments, "manip replay")
    dump = load_tree(options.dump)
    if not isinstance(dump, dict) or dump.get("format") != DUMP_FORMAT:
        raise UserError(f"{options.dump} is not a step that a run kept")
    try:
        recorded = Fault(**dump["fault"])
        task = load_task_named_by(options.dump.parent, dump["task"])
        worlds = _world(dump, task)
        before = _motion(worlds)
        worlds.step(dump["action"][None])
    except UserError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{options.dump} does not fit this version: {one_line(error)}"
        ) from error
    console = Console(soft_wrap=True)
    console.print(f"then: {recorded}", markup=False, highlight=False)
    console.print(_table(before, _motion(worlds)))
    action = np.array2string(dump["action"], precision=3)
    now = "; ".join(map(str, worlds.faults)) or "all is well"
    console.print(f"action: {action}\nnow: {now}", markup=False)
    return 1 if worlds.faults else 0


def _world(dump: dict[str, Any], task: Task) -> NativeBatch:
    """The one world, as it was before the step."""
    robot = RobotConfig(**dump["robot"])
    options = {name: dump[name] for name in ("fidelity", "reward", "reward_weights")}
    worlds = NativeBatch(task, 1, robot=robot, threads=1, **options)
    zero = np.zeros(1, np.int64)
    state = {"states": dump["state"][None], "readings": dump["readings"][None]}
    worlds.load_state(state | {"elapsed": zero, "episode": zero, "fault_count": 0})
    return worlds


def _motion(worlds: NativeBatch) -> dict[str, tuple[float, float]]:
    """Joint -> its first coordinate and the largest of its velocities."""
    model, state = worlds.scene.physics, worlds.engine.states[0]
    joints = [model.joint(i) for i in range(model.njnt)]
    return {
        joint.name: (
            float(state[joint.qposadr[0]]),
            float(
                np.abs(state[model.nq :][joint.dofadr[0] :][: _freedoms(joint)]).max()
            ),
        )
        for joint in joints
    }


def _freedoms(joint: Any) -> int:
    return {0: 6, 1: 3}.get(int(joint.type[0]), 1)


def _table(
    before: dict[str, tuple[float, float]], after: dict[str, tuple[float, float]]
) -> Table:
    shown = Table("joint", "position", "speed", "position after", "speed after")
    for name in before:
        shown.add_row(name, *(f"{value:.4g}" for value in before[name] + after[name]))
    return shown
