"""Preferences: comparisons of clips, a reward learned from them, and its use."""
