"""Simulation: the only room that touches mujoco, numba and robosuite."""
