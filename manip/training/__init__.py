"""Training: one loop for all algorithms, its options, logs and checkpoints."""
