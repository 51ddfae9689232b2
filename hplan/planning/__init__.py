"""From start to goal: grasps, roadmap, grid path, smoothing, timing and certificate, tried in turn until certified.

`plan` is the pipeline as a whole. May use every room above it.
"""
