"""From start to goal: the problem, its grasps, paths, the fastest motion along them and its certificate.

`plan` is the whole; `sampling` finds paths by RRT-Connect, `moving` motions past obstacles that move, `lower_bound`
durations that no motion can fall below, `finishing` works on paths that others have planned.
"""
