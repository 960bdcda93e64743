"""Benchmarks: one file each, all held as contests whose contestants take turns."""
