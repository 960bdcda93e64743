"""Preferences: clips of behaviour, comparisons of them, and learning from these."""
