"""Collision bodies of any robot and their distances: compiled for the planner, by coal for the certificate.

`collision_bodies` are convex cores with a radius; `reach` and `twists` say how far and how fast joints move them;
`arm_pairs` and `geometry_pairs` which of them are held against which.
"""
