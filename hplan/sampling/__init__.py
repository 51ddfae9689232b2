"""Paths by sampling, with edges shown clear over continuous time: quick ones of a roadmap, any by RRT-Connect.

May use the rooms up to `problem`.
"""
