"""Run an exported policy on a robot: numpy, and onnxruntime for .onnx files, alone.

This folder imports nothing else of manip (docs/real-arm.md).
"""
