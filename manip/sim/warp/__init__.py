"""MuJoCo Warp as an engine: the same scenes and control laws, on an NVIDIA GPU.

Modules here import warp and mujoco_warp (the extra `gpu`), except `library` and
`sizes`. docs/gpu.md says what this engine promises.
"""
