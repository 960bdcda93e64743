"""Compare contacts on C and on MuJoCo Warp in states of a task's expert."""

from typing import Any

import numpy as np

from manip.envs.make_batch import make_batch
from manip.envs.task import Task
from manip.robot_config import RobotConfig
from manip.sim.scene import Scene
from manip.sim.warp.contact_differences import ContactDifferences
from manip.sim.warp.library import Device
from manip.sim.warp.sizes import sizes_of

Array = np.ndarray

EPISODES, EVERY = 8, 10
"""Episodes of the expert, and control steps between the states that are compared."""


def contact_differences(
    task: Task, robot: RobotConfig, device: Device
) -> dict[str, ContactDifferences]:
    """Kind of pair, such as box-box -> how its contacts differ, in the expert's states.

    Raises:
        UserError: the task has no expert.
    """
    from manip.sim.warp.contact_comparison import compare_contacts  # the extra `gpu`
    from manip.sim.warp.warp_engine import WarpEngine

    scene, instants = _expert_states(task, robot)
    engine = WarpEngine(scene, EPISODES, sizes_of(scene, None, None), device)
    differences: dict[str, ContactDifferences] = {}
    for rows in instants:
        _set(engine, rows)
        compare_contacts(engine, differences)
    return differences


def _expert_states(task: Task, robot: RobotConfig) -> tuple[Scene, list[Array]]:
    """The scene, and state rows [EPISODES, S] at several instants."""
    batch: Any = make_batch(task, EPISODES, robot=robot)
    batch.begin(np.arange(EPISODES))
    instants = []
    for step in range(batch.horizon):
        batch.step(batch.expert())
        if step % EVERY == 0:
            instants.append(batch.engine.states.copy())
    return batch.scene, instants


def _set(engine: Any, rows: Array) -> None:
    """Put the engine into states, and compute their contacts."""
    columns, scene = engine.state_columns, engine.scene
    fields = {slot.name: rows[:, columns(slot.name)] for slot in scene.layout.fields}
    qpos, qvel = rows[:, columns("qpos")], rows[:, columns("qvel")]
    engine.set_state(np.arange(len(rows)), qpos, qvel, fields=fields)
