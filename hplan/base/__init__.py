"""Utilities without robots: arrays, argument checks, files, compiled kernels.

Imports nothing of hplan but `hplan.errors`.
"""
