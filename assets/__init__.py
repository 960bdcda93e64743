"""Scenes, recipes and trained policies that ship with manip."""
