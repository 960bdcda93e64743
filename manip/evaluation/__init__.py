"""Evaluation: whole episodes, statistics, reports; a policy is a callable."""
