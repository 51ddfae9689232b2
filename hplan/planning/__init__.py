"""Motion planning: problem, grasps, paths, fastest motion and its certificate.

`plan` is the whole pipeline. `sampling` finds paths by RRT-Connect, `moving` finds motions past moving obstacles,
`lower_bound` computes lower bounds of durations, and `finishing` makes certified motions of given paths.
"""
