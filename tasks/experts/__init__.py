"""Scripts: a few lines that solve a task, to show that it can be, and to be cloned.

Each maps measures [N, ...] to OSC_POSE actions [N, A] and remembers nothing.
"""
