"""Gradients in compiled code, checked against TorchRL's losses."""
