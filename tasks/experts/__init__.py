"""Scripted experts: each solves a task, which proves it solvable, and can be cloned.

An expert maps measures [N, ...] to OSC_POSE actions [N, A] and has no state.
"""
