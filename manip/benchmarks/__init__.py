"""Benchmarks: one file each; all candidates of a benchmark are measured in turns."""
