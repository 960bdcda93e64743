"""Studies: measurements of what policy gradient algorithms and their options do."""
