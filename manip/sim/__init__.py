"""Simulation: the only room that uses mujoco, numba and robosuite."""

import os

from manip.sim.gl import import_mujoco

if "MUJOCO_GL" in os.environ:  # an invalid value keeps mujoco from being imported
    import_mujoco()
