"""Tools of every room, without robots: arrays, checks of arguments, files, compiled kernels, plane geometry.

Imports nothing of hplan but `hplan.errors`.
"""
