"""The analytic C-space: sections of obstacles by the arm's plane, equations (1)-(3), the occupancy of the joint grid.

`occupancy` holds the paper's equations, `sections` what they are applied to. May use the rooms up to `planar` and
`search.grid`.
"""
