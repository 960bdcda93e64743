"""Simulations that another library steps."""
