"""Environments of the batch engine in the state of a stock environment."""

from collections.abc import Iterable

import numpy as np

from manip.envs.task import Task
from manip.sim.batch_engine import BatchEngine
from manip.sim.robosuite_factory import reseed
from manip.sim.stock_reader import stock_reader

RESYNCED = {
    "NutAssembly": 5,
    "NutAssemblyRound": 5,
    "NutAssemblySquare": 5,
    "PickPlace": 1,
    "PickPlaceCan": 1,
    "PickPlaceMilk": 1,
    "ToolHang": 5,
}
"""Steps after which the state of stock is copied again in an episode of the expert. An
object that slides along a peg or into a post with a millimetre of play turns
differences of 1e-8 into millimetres; one that rattles between the fingers turns 1e-10
into 1e-5 at once."""


def start_twin(task: Task, engine: BatchEngine, env_ids: Iterable[int], seed: int):
    """Reset the engine's stock environment and put `env_ids` in its start state."""
    stock = engine.scene.stock
    reseed(stock, seed)
    observation = stock.reset()
    copy_start(task, engine, env_ids)
    return observation


def copy_start(task: Task, engine: BatchEngine, env_ids: Iterable[int]) -> None:
    """Put `env_ids` at the start of the episode that the stock environment began."""
    stock = engine.scene.stock
    # Stock's first step after a reset would use the mass matrix of its construction
    # (an effect below 1e-6 rad); the engine has no such lag.
    for robot in stock.robots:
        for part in robot.part_controllers.values():
            part.new_update = True
    read = stock_reader(stock, task.sensors)()
    env_ids = np.array(list(env_ids))
    rows = np.zeros(len(env_ids), dtype=int)
    fields = {name: read[name][rows] for name in task.sensors.fields}
    engine.reset(env_ids, read["qpos"][rows], fields)
    update_memory(task, engine, env_ids)


def update_memory(task: Task, engine: BatchEngine, env_ids: np.ndarray) -> None:
    """Update the task's memory in some environments [n] int."""
    memory = task.update_memory(task.measure(engine.read()))
    engine.write_memory(
        env_ids, {name: values[env_ids] for name, values in memory.items()}
    )


def copy_state(task: Task, engine: BatchEngine, env_ids: Iterable[int]) -> None:
    """Put `env_ids` in the present state of the stock environment, in mid-episode."""
    stock = engine.scene.stock
    read, data = stock_reader(stock, task.sensors)(), stock.sim.data._data
    hidden = "start_pos", "gripper_command", *task.sensors.fields
    state = [data.qpos, data.qvel, data.qacc_warmstart, *(read[n][0] for n in hidden)]
    row = np.concatenate(state)
    engine.states[list(env_ids), : len(row)] = row


def reading(engine: BatchEngine, env_id: int) -> dict[str, np.ndarray]:
    """Copy the readings of one environment, as a batch of one."""
    return {
        name: values[env_id : env_id + 1].copy() if len(values) > 1 else values.copy()
        for name, values in engine.read().items()
    }
