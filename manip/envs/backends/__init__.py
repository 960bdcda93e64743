"""What steps a batch of task environments."""
