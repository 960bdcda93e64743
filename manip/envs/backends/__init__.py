"""Backends that step a batch of task environments."""
