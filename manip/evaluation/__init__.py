"""Evaluation: run whole episodes of a policy, and report rates with uncertainty."""
