"""Environments: tasks as TorchRL, on the engine and in stock robosuite."""
