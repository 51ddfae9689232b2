"""From start to goal: grasps, trees, grid path, smoothing, timing and certificate, tried in turn until certified.

`plan` is the pipeline as a whole. May use every room above it.
"""
