"""The compiled loop of the batch engine: one control period of some environments.

A control period is robosuite's own sequence (environments/base.py): `mj_step1`, goal
latched at the first substep, control law, `mj_step2`.
"""

from math import isnan
from typing import NamedTuple

import numpy as np

from manip.compiled import jit, kernel
from manip.sim.atomic_counter import take_number
from manip.sim.control_laws import Works
from manip.sim.control_step import control
from manip.sim.libmujoco import mj_forward, mj_step1, mj_step2
from manip.sim.robot_model import Robot
from manip.sim.sim_memory import Sim, load, store

Array = np.ndarray

LIMIT = 1e8
"""An environment whose |qpos| or |qvel| passes this is broken (MuJoCo: 1e10)."""


class Plan(NamedTuple):
    """Constants of a control period.

    substeps: simulation steps per control period. touch_start: column of the first
    touch in a readings row. touch_of_sensor: for each contact sensor the touch that it
    adds to. touch_limit [K]: the largest number of each touch, 1 for a flag.
    """

    substeps: int
    touch_start: int
    touch_of_sensor: Array
    touch_limit: Array


@kernel
def _store_touches(row: Array, plan: Plan, contacts: Array) -> None:
    for k in range(plan.touch_start, len(row)):
        row[k] = 0.0
    for k in range(len(plan.touch_of_sensor)):
        touch = plan.touch_of_sensor[k]
        total = row[plan.touch_start + touch] + contacts[k]
        row[plan.touch_start + touch] = min(plan.touch_limit[touch], total)


@kernel
def _within_limits(values: Array) -> bool:
    for i in range(len(values)):
        if not abs(values[i]) < LIMIT:  # also False for NaN
            return False
    return True


@kernel
def _advance(
    sim: Sim, plan: Plan, robots: tuple[Robot, ...], works: Works, action: Array
) -> bool:
    """Take one control period from the loaded state; False if it became non-finite."""
    for k in range(len(action)):
        if isnan(action[k]):  # clipping would make it -1: full speed
            return False
    for substep in range(plan.substeps):
        mj_step1(sim.model, sim.data)
        if not control(sim, robots, works, action, substep):
            return False
        mj_step2(sim.model, sim.data)
        if not (_within_limits(sim.qpos) and _within_limits(sim.qvel)):
            return False
    return True


@jit
def step_environments(
    sim: Sim,
    plan: Plan,
    robots: tuple[Robot, ...],
    works: Works,
    actions: Array,
    states: Array,
    readings: Array,
    next_states: Array,
    next_readings: Array,
    broken: Array,
    counter: Array,
) -> None:
    """Step the environments whose numbers this thread takes from `counter` [1].

    All threads share the counter. The state and readings of a broken
    environment do not change.
    """
    while True:
        env_id = take_number(counter.ctypes.data)
        if env_id >= len(states):
            return
        next_states[env_id] = states[env_id]  # memory stays, which no step changes
        load(states[env_id], sim.state)
        broken[env_id] = not _advance(sim, plan, robots, works, actions[env_id])
        if broken[env_id]:
            next_readings[env_id] = readings[env_id]
        else:
            store(next_states[env_id], sim.state)
            store(next_readings[env_id], sim.slots)
            _store_touches(next_readings[env_id], plan, sim.contacts)


@jit
def refresh_environments(
    sim: Sim,
    plan: Plan,
    states: Array,
    readings: Array,
    env_ids: Array,
    counter: Array,
) -> None:
    """Run `mj_forward` in some environments, as at the end of robosuite's reset."""
    for i in range(len(sim.ctrl)):
        sim.ctrl[i] = 0.0
    for i in range(len(sim.peaks)):
        sim.peaks[i] = 0.0
    while True:
        i = take_number(counter.ctypes.data)
        if i >= len(env_ids):
            return
        load(states[env_ids[i]], sim.state)
        mj_forward(sim.model, sim.data)
        store(states[env_ids[i]], sim.state)
        store(readings[env_ids[i]], sim.slots)
        _store_touches(readings[env_ids[i]], plan, sim.contacts)
