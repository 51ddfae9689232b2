"""Distances between arm and scene: compiled kernels for the planner, coal by way of Pinocchio for the certificate.

May use the rooms up to `robot`; `arm_pairs` and `geometry_pairs` say which bodies are held against which.
"""
