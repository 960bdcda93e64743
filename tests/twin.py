"""A world of the batch engine that starts where a stock environment stands."""

from collections.abc import Iterable

import numpy as np

from manip.envs.task import Task
from manip.sim.batch_engine import BatchEngine
from manip.sim.robosuite_factory import reseed
from manip.sim.stock_reader import stock_reader

RESYNCED = {
    "NutAssemblyRound": 5,
    "NutAssemblySquare": 5,
    "PickPlaceCan": 1,
    "PickPlaceMilk": 1,
    "ToolHang": 5,
}
"""Steps after which a scripted twin is put where stock is: what slides along a peg or
into a post with a millimetre of play turns differences of 1e-8 into millimetres, and
what rattles between the fingers 1e-10 into 1e-5 at once."""


def start_twin(task: Task, engine: BatchEngine, worlds: Iterable[int], seed: int):
    """Reset the engine's stock environment and put `worlds` where it starts."""
    stock = engine.scene.stock
    reseed(stock, seed)
    found = stock.reset()
    copy_start(task, engine, worlds)
    return found


def copy_start(task: Task, engine: BatchEngine, worlds: Iterable[int]) -> None:
    """Put `worlds` at the start of the episode that the stock environment began."""
    stock = engine.scene.stock
    # Stock's first step after a reset would use the mass matrix of its construction
    # (an effect below 1e-6 rad); the engine has no such lag.
    for part in stock.robots[0].part_controllers.values():
        part.new_update = True
    read = stock_reader(stock, task.sensors)()
    worlds = np.array(list(worlds))
    rows = np.zeros(len(worlds), dtype=int)
    fields = {name: read[name][rows] for name in task.sensors.fields}
    engine.reset(worlds, read["qpos"][rows], fields)
    update_memory(task, engine, worlds)


def update_memory(task: Task, engine: BatchEngine, worlds: np.ndarray) -> None:
    """Let a task keep what it wants of the episodes of some worlds [n] int."""
    kept = task.update_memory(task.measure(engine.read()))
    engine.write_memory(worlds, {name: values[worlds] for name, values in kept.items()})


def copy_state(task: Task, engine: BatchEngine, worlds: Iterable[int]) -> None:
    """Put `worlds` where the stock environment is now, in the midst of its episode."""
    stock = engine.scene.stock
    read, data = stock_reader(stock, task.sensors)(), stock.sim.data._data
    hidden = "start_pos", "gripper_command", *task.sensors.fields
    state = [data.qpos, data.qvel, data.qacc_warmstart, *(read[n][0] for n in hidden)]
    row = np.concatenate(state)
    engine.states[list(worlds), : len(row)] = row


def reading(engine: BatchEngine, world: int) -> dict[str, np.ndarray]:
    """What a world reads now, kept as a batch of one."""
    return {
        name: values[world : world + 1].copy() if len(values) > 1 else values.copy()
        for name, values in engine.read().items()
    }
