"""Utilities without robots: arrays, argument checks, files, compiled kernels, planar geometry.

Imports nothing of hplan but `hplan.errors`.
"""
