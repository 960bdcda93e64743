"""Physics without control laws: the bound that the engine's speed is compared with."""

from collections.abc import Callable

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from manip.compiled import jit
from manip.sim.batch_engine import BatchEngine
from manip.sim.control_laws import Works
from manip.sim.control_step import control
from manip.sim.libmujoco import mj_step1, mj_step2
from manip.sim.robot_model import Robot
from manip.sim.sim_memory import Sim, load
from manip.sim.thread_data import thread_data

Array = np.ndarray


def bare_physics(
    engine: BatchEngine, actions: Array, threads: int
) -> Callable[[], Array]:
    """Build a function that repeats the engine's steps in `mujoco.rollout`, in C.

    The controls of every substep are recorded beforehand, so that the repetition has
    the same contacts and computes no control law.

    Args:
        engine: its present states are the start; they do not change.
        actions: [T, N, A], the control steps to take.
        threads: number of threads of the rollout.

    Returns:
        A function that takes T control steps in all environments and returns their
        last qpos [N, nq].
    """
    model = engine.scene.physics
    nq, nv = model.nq, model.nv
    controls = _recorded(engine, actions)
    starts = np.zeros((engine.num_envs, 1 + nq + nv))  # the first is the time
    starts[:, 1:] = engine.states[:, : nq + nv]
    warmstart = engine.states[:, nq + nv : nq + 2 * nv].copy()
    states = np.zeros((*controls.shape[:2], 1 + nq + nv))
    sensordata = np.zeros((*controls.shape[:2], model.nsensordata))
    pool = Rollout(nthread=threads if threads > 1 else 0)
    datas = [mujoco.MjData(model) for _ in range(threads)]

    def run() -> Array:
        pool.rollout(
            model,
            datas,
            starts,
            controls,
            initial_warmstart=warmstart,
            state=states,
            sensordata=sensordata,
        )
        return states[:, -1, 1 : 1 + nq]

    return run


def _recorded(engine: BatchEngine, actions: Array) -> Array:
    """[N, T * substeps, nu]: the controls that the engine would apply."""
    scene = engine.scene
    memory = thread_data(scene)
    shape = engine.num_envs, len(actions) * scene.substeps, scene.physics.nu
    controls = np.zeros(shape)
    robots = scene.layout.robots
    _record(memory.sim, robots, memory.works, actions, engine.states, controls)
    return controls


@jit
def _record(
    sim: Sim,
    robots: tuple[Robot, ...],
    works: Works,
    actions: Array,
    states: Array,
    controls: Array,
) -> None:
    substeps = controls.shape[1] // len(actions)
    for env_id in range(len(states)):
        load(states[env_id], sim.state)
        for substep in range(controls.shape[1]):
            action = actions[substep // substeps, env_id]
            mj_step1(sim.model, sim.data)
            control(sim, robots, works, action, substep % substeps)
            for k in range(len(sim.ctrl)):
                controls[env_id, substep, k] = sim.ctrl[k]
            mj_step2(sim.model, sim.data)
