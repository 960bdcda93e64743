"""Algorithms on TorchRL losses: one file each, and the policies they make."""
