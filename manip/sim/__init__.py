"""Simulation: the only package that uses mujoco, numba and robosuite."""

import os

from manip.sim.gl import import_mujoco

if "MUJOCO_GL" in os.environ:  # import mujoco fails with an invalid value
    import_mujoco()
