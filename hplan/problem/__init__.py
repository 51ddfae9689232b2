"""A planning problem: options, start and goal, the world about the arm, the joint ranges that can be reached.

May use the rooms up to `verification`.
"""
