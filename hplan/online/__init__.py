"""Online planning: the scene changes and the arm moves while motions are planned.

`planner` plans again when the scene changes, `splice` while a motion runs. May use every room above it.
"""
