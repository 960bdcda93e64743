"""Studies: what the lesson on policy gradients claims, measured on an arm."""
