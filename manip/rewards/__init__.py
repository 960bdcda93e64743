"""Reward shaping: bounded kernels and their composition."""
