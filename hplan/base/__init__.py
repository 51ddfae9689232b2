"""What every room uses and no robot needs: arrays, checks of arguments, files, compiled kernels, plane geometry.

Imports nothing of hplan but `hplan.errors`.
"""
