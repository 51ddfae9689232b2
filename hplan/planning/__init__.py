"""Motion planning: problem, grasps, paths, fastest motion and its certificate.

`plan` is the whole pipeline, and `lower_bound` computes lower bounds of durations.
"""
